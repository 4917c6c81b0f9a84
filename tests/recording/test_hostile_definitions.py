"""Message definitions of a bag are data: never executed, read in bounded time, refused in one
line."""

import builtins
import time
from pathlib import Path

import numpy as np
import pytest
from rosbags.typesys import get_types_from_idl
from rosbags.typesys.store import Typestore

from elastic_arm.errors import RecordingError
from elastic_arm.recording import cdr, limits, message_types
from elastic_arm.recording.message_types import parse_definition
from elastic_arm.recording.reading import read_recording
from elastic_arm.recording.storage.metadata import Topic
from tests.helpers.bags import stamps, states, write_foreign

TYPE = "a_msgs/msg/T"
IDL = """
module a_msgs { module msg {
    typedef double double__36[36];
    %(extra)s
    @verbatim (language="comment", text="hello { } ; " "(")
    struct T { /* a ; comment */
        std_msgs::msg::Header header;  // another }
        @default (value=1.0) double x;
        double__36 cov; sequence<double> s; sequence<a_msgs::msg::B, 3> b;
        string<5> str; unsigned long ul; long long ll, l2; octet o; boolean ok; uint8 arr[4];
    };
}; };
"""
HOSTILE_IDL = {
    "nested brackets in a constant": "const long A = "
    + "(" * 40
    + "1"
    + ")" * 40
    + "; struct T { double x[A]; };",
    "a shift by 60000": "const long A = 1 << 60000; struct T { double x[A]; };",
    "a type that contains itself": "struct T { T t; };",
    "types that contain each other": "struct A { B b; }; struct B { sequence<A> a; };",
    "a long name": "struct T { a" + "::a" * 200_000 + " b; };",
    "deep sequences": "struct T { " + "sequence<" * 1000 + "double" + ">" * 1000 + " x; };",
    "a typedef of itself": "typedef A A; struct T { A a; };",
    "modules in each other": "module a { " * 90_000,
    "open comments": "/*" * 400_000,
    "open comments with blanks": "/* " * 200_000,
    "open comments behind a type": "struct T { double x; }; " + "/* " * 200_000,
    "escaped quotes": '"' + r"\"" * 400_000,
    "strings that do not end": r'"\"' * 200_000,
    "open brackets": "<" * 900_000,
    "open annotations": "@a(" * 300_000,
    "open strings": '"' * 900_001,
    "a struct in a struct": "struct T { struct A { long b; }; };",
    "many fields": "struct T { " + "double x[3]; " * 50_000 + "};",
    "an array of 1e11": "struct T { double x[100000000000]; };",
    "two megabytes": "// " + "x" * 2_000_000,
}
HOSTILE_MSG = {
    "a type that contains itself": "T t",
    "types that contain each other": f"A a\n{'=' * 80}\nMSG: a_msgs/A\nT t",
    "code": "float64 x\n__import__('os').system('touch /tmp/owned')",
    "a name that is none": f"float64 x\n{'=' * 80}\nMSG: 1a/msg/X\nfloat64 y",
    "an array of 1e11": "float64[100000000000] x",
    "a long line": "a" * 900_000,
    "many types": "".join(f"\n{'=' * 80}\nMSG: a/T{i}\nfloat64 x" for i in range(3000)),
}


def refused(encoding: str, text: str, type_name: str = TYPE) -> str:
    """Return the one short line of the refusal, of the definition or of the first message, which
    must come at once."""
    begin = time.process_time()
    with pytest.raises(RecordingError) as caught:
        defined = message_types.types_of(Topic("/t", type_name, text, "", "", encoding))
        cdr.layout_of(memoryview(bytes([0, 1, 0, 0]) + bytes(2000)), type_name, defined)
    assert time.process_time() - begin < 5.0
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300
    return str(caught.value)


def test_the_fields_are_those_of_the_library() -> None:
    """All standard types come out of their ros2msg texts as rosbags itself describes them."""
    store = message_types.typestore()
    for name in store.fielddefs:
        text, _ = store.generate_msgdef(name, ros_version=2)
        for found, (_, fields) in parse_definition(name, "ros2msg", text).items():
            assert fields == store.fielddefs[found][1], found


def test_idl_is_read_as_the_library_reads_it() -> None:
    """Comments, annotations and constants change nothing; sizes may be constants."""
    extra = 'module T_Constants { const long A = 5; const string S = "a;b}"; };'
    found = parse_definition(TYPE, "ros2idl", '#include "x.idl"\n' + IDL % {"extra": extra})
    assert found[TYPE][1] == get_types_from_idl(IDL % {"extra": extra})[TYPE][1]
    sized = parse_definition(TYPE, "ros2idl", "const long A = 5; struct T { double x[A]; };")
    assert sized["T"][1][0][1][1][1] == 5


@pytest.mark.parametrize("name", HOSTILE_IDL)
def test_hostile_idl_is_refused_at_once(name: str) -> None:
    """What makes the library's parser take minutes, or fail in its own words, never reaches it."""
    refused("ros2idl", HOSTILE_IDL[name])


@pytest.mark.parametrize("name", HOSTILE_MSG)
def test_hostile_msg_is_refused_at_once(name: str) -> None:
    """Lines are fields, and types that hold each other end with the first message."""
    refused("ros2msg", HOSTILE_MSG[name])


@pytest.mark.parametrize(
    "type_name", ["1a/msg/X", "a/msg/X\nfloat64 y", "a/msg/X'); import os #", "", "a" * 10**6]
)
def test_a_name_that_is_no_type_is_refused(type_name: str) -> None:
    """The name of the type itself follows the grammar, too."""
    assert "is not a valid type name" in refused("ros2msg", "float64 x", type_name)


def test_an_unknown_language_is_named() -> None:
    """Protobuf and the like are refused as such."""
    assert "'protobuf'" in refused("protobuf", "message T {}")


def test_no_definition_is_executed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading a bag with definitions neither registers them with the library nor calls exec, eval
    or compile."""
    bag = write_foreign(tmp_path / "bag", states("/joint_states", stamps(300)))
    read_recording(bag)  # imports what it needs
    parse_definition.cache_clear()

    def forbidden(*_: object, **__: object) -> None:
        raise AssertionError("text of a bag was executed")

    monkeypatch.setattr(Typestore, "register", forbidden)
    with monkeypatch.context() as patch:
        for name in ("exec", "eval"):
            patch.setattr(builtins, name, forbidden)
        assert len(read_recording(bag).link) == 300


def test_a_message_of_nothing_is_not_walked_for_ever() -> None:
    """Arrays of empty types in each other take no bytes, and are not counted out one by one."""
    parts = ["T1[1000] x"]
    parts += [f"{'=' * 80}\nMSG: a_msgs/T{i}\nT{i + 1}[1000] x" for i in range(1, 5)]
    parts += [f"{'=' * 80}\nMSG: a_msgs/T5\nuint8[0] x"]
    types = message_types.types_of(Topic("/t", TYPE, "\n".join(parts), "", "", "ros2msg"))
    message = memoryview(bytes([0, 1, 0, 0]) + bytes(2000))
    begin = time.process_time()
    with pytest.raises(RecordingError, match=f"more than {limits.WALKED_FIELDS} fields"):
        cdr.layout_of(message, TYPE, types)
    assert time.process_time() - begin < 5.0


def test_messages_of_endless_layouts_are_refused(tmp_path: Path) -> None:
    """A topic whose every message names other joints is refused, not held in one table a
    message."""
    rng = np.random.default_rng(0)
    messages = []
    for stamp in stamps(limits.LAYOUTS + 10):
        (message,) = states("/joint_states", [stamp])
        frame = bytes(rng.integers(97, 122, 7, dtype=np.uint8))
        messages.append((*message[:3], message[3].replace(b"joint_1", frame)))
    with pytest.raises(RecordingError, match="different combinations of names and lengths"):
        read_recording(write_foreign(tmp_path / "bag", messages))
