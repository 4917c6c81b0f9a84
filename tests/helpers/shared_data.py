"""Recordings and descriptions of real robots, in a folder beside the tree that a clone may lack."""

from pathlib import Path

import pytest

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason=f"there are no real recordings in {DATA}")
