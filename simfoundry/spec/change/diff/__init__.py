"""What changed between two documents: as data that can be applied, and in the words of the scene."""
