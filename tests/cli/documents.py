"""Small documents that the tests of several commands check and compare."""

from __future__ import annotations

GOOD = "simfoundry: scene/1\nname: good\nobjects: {cup: {shape: {sphere: 0.04}, mass: 0.2}}\n"
BAD = "simfoundry: scene/1\nname: bad\nobjects: {cup: {shape: {sphere: 0.04}, mas: 0.2}}\n"
WARNED = "simfoundry: scene/1\nname: warned\nmaterials:\n  wood: {density: 700}\n"
"""Documents without a finding, with two errors (a wrong key, no mass) and with one warning."""
