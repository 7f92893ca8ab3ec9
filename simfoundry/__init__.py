"""SimFoundry: one typed scene spec, many simulators.

Importing this package loads no simulator, no USD and no mesh library.
"""

__version__ = "0.1.0"
