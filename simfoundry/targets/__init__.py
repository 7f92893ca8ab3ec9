"""Targets, which are simulators described as data.

A profile names a backend and describes how the simulator interprets the files.
"""
