"""Simulators and pictures: one protocol over the engines that hold a compiled scene."""
