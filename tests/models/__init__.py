from __future__ import annotations

import sys

from tests.conftest import REPOSITORY

# Model servers lie in one folder, as in a model's environment, and import each other by their plain names.
SERVERS = REPOSITORY / "examples" / "servers"
if str(SERVERS) not in sys.path:
    sys.path.insert(0, str(SERVERS))
