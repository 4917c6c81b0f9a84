"""Names of terms."""

from typing import Any

Key = tuple[str, str | None, tuple[Any, ...]]  # effect, joint, choices
Ident = tuple[Any, ...]  # of one term with its columns and prior
