"""The command ``python -m tests.benchmarks.terse``."""

import sys

from tests.benchmarks.terse.counts import main

sys.exit(main())
