"""Targets: simulators that are described as data.

A profile names a backend and describes how the simulator interprets the files.
"""
