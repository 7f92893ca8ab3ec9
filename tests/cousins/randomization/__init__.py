"""Tests of the axis `vary`."""
