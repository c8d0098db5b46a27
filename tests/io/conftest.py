"""Lets the tests of this folder import `io_samples`, which writes files as trackers do."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
