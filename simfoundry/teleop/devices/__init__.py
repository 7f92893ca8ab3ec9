"""The devices. Each is a state machine that turns packets into commands, and knows nothing of cables and pages."""
