"""Links to devices: they receive packets in a thread of their own, and find a device again after it was unplugged."""
