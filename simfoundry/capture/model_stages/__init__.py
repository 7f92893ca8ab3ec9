"""Stages of a reconstruction that ask foundation models, each with a method that needs none."""
