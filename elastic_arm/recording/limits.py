"""Limits on the memory that a bag may use, whatever sizes it states; some can be set by environment
variables.

`$ELASTIC_ARM_MAX_CHUNK_MB` limits the unpacked size of a chunk, `$ELASTIC_ARM_MAX_UNPACKED_MB` that
of a file.
"""

import os

from elastic_arm.errors import RecordingError

MEGABYTE = 1_000_000
# What recorders write is below 20 MB a chunk; a file that unpacks to more than half of the memory
# cannot be decoded.
CHUNK_MB = 512
MEMORY_SHARE = 0.5

# Of a message definition. The largest one of ROS (a planning scene of MoveIt) has 60 kB, 70 types
# and 400 fields.
DEFINITION_BYTES = 1_000_000
DEFINITION_FIELDS = 2000

# Of the messages of one topic: fields met in walking one message, and layouts (lengths, names,
# orders of joints), whose fields together are about so many.
WALKED_FIELDS = 100_000
LAYOUTS = 256
LAYOUT_FIELDS = 1_000_000
# Names in a message, and numbers in a field of its values: the largest robots have some hundred
# joints.
COLUMNS = 10_000

METADATA_BYTES = 10 * MEGABYTE
FILES = 10_000  # that metadata.yaml names
CHANNELS = 5000  # topics that a file describes; the largest systems have some thousand
# Records of an MCAP file that are no messages: by number in a chunk, where they describe channels,
# and beside chunks by the least bytes that one has with its share of what it stands for.
RECORDS = 200_000
RECORD_BYTES = 50


def chunk_bytes() -> int:
    """Return the largest unpacked size of a chunk, and of a message in a database."""
    return _configured("ELASTIC_ARM_MAX_CHUNK_MB", CHUNK_MB)


def unpacked_bytes() -> int:
    """Return the largest unpacked size of a file."""
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return _configured(
        "ELASTIC_ARM_MAX_UNPACKED_MB", max(int(MEMORY_SHARE * memory) // MEGABYTE, CHUNK_MB)
    )


def _configured(name: str, megabytes: int) -> int:
    given = os.environ.get(name, "").strip()
    if given and not (given.isascii() and given.isdecimal() and 0 < len(given) < 10):
        raise RecordingError(f"${name} is {given[:40]!r}", "Give whole megabytes, such as 512.")
    return int(given or megabytes) * MEGABYTE
