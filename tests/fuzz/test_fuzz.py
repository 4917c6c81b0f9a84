"""A short run of the fuzzing: mutants of bags and files, and structures that no seed holds."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from elastic_arm.errors import ElasticArmError
from elastic_arm.excitation import load_trajectory
from elastic_arm.input_files import read_fields
from elastic_arm.recording import load_channels
from elastic_arm.recording.foreign.arrays import load_array_map
from elastic_arm.recording.message_types import parse_definition
from elastic_arm.robot import load_robot
from elastic_arm.robot.loading import NOMINAL_ARM
from tests.fuzz.campaign import run, try_one
from tests.fuzz.targets import CHANNELS, MAP, targets

SECONDS = 3.0  # a group; `make fuzz` takes hours
BRIEF = settings(max_examples=80, deadline=None, database=None, derandomize=True,
                 suppress_health_check=list(HealthCheck))  # fmt: skip
SCALARS = (
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.dates()
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(SCALARS, inner, max_size=4),
    max_leaves=8,
)
LOADERS = {
    "arm": (load_robot, yaml.safe_load(NOMINAL_ARM.read_text())),
    "channels": (load_channels, yaml.safe_load(CHANNELS)),
    "mapping": (load_array_map, yaml.safe_load(MAP)),
    "trajectory": (
        load_trajectory,
        {
            "schema": "elastic_arm/trajectory/1",
            "omega": 1.0,
            "a": [[1.0]],
            "b": [[1.0]],
            "q0": [0.0],
            "duration": 9.0,
        }
        | {"ramp": 1.0, "joints": ["a"]},
    ),
}
MARKS = [
    "{",
    "}",
    "<",
    ">",
    "[",
    "]",
    ";",
    ",",
    "::",
    "=",
    "@",
    "(",
    ")",
    "//",
    "/*",
    "*/",
    "\n",
    " ",
    '"',
    "#",
]
NAMES = [
    "module",
    "struct",
    "typedef",
    "const",
    "long",
    "double",
    "sequence",
    "string",
    "T",
    "a",
    "3",
    "float64",
]
LINES = ["string<=5", "MSG: a/T\n", "=" * 80 + "\n", "T x\n", "float64[3] x\n", "1 << 60000"]
WORDS = st.sampled_from([*MARKS, *NAMES, *LINES])


@pytest.mark.slow(4)
@pytest.mark.parametrize("group", ["bags", "files"])
def test_no_mutant_gets_more_than_a_line(tmp_path: Path, group: str) -> None:
    """Every mutant is read or refused in one line within five seconds."""
    found = run(tmp_path, SECONDS, np.random.default_rng(1), group)
    failures = [words for outcome in found.values() for words in outcome.failures]
    assert not failures, failures[0]
    assert all(outcome.counts.total() > 0 for outcome in found.values())


def test_every_whole_file_is_read(tmp_path: Path) -> None:
    """What the mutants are made of reaches the end of what reads it: otherwise they would try the
    first step alone."""
    for name, target in targets(tmp_path / "seeds").items():
        for content in target.seeds:
            assert try_one(target, tmp_path / f"whole{target.suffix}", content) == ("read", ""), (
                name
            )


@pytest.mark.parametrize("name", LOADERS)
@BRIEF
@given(data=st.data())
def test_any_value_anywhere_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, name: str, data: st.DataObject
) -> None:
    """A file whose fields are sound but for one, at any depth, which may be anything that YAML
    holds."""
    load, whole = LOADERS[name]
    content = yaml.safe_load(yaml.safe_dump(whole))
    at = content
    key = data.draw(st.sampled_from(sorted(content)))
    while isinstance(at[key], (dict, list)) and at[key] and data.draw(st.booleans()):
        at = at[key]
        key = data.draw(st.sampled_from(sorted(at) if isinstance(at, dict) else range(len(at))))
    at[key] = data.draw(VALUES)
    file = tmp_path_factory.getbasetemp() / f"{name}.yaml"
    file.write_text(yaml.safe_dump(content, allow_unicode=False))
    try:
        load(file)
    except ElasticArmError as error:
        assert len(str(error)) < 2500 and str(error).isprintable()


@BRIEF
@given(text=st.text(alphabet="[]{}:,&*a1-? \n!|>'\"#%@<.", max_size=60))
def test_any_text_is_yaml_or_refused(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    """Any marks of YAML in any order."""
    file = tmp_path_factory.getbasetemp() / "a.yaml"
    file.write_text(text)
    try:
        assert isinstance(read_fields(file, ElasticArmError, ""), dict)
    except ElasticArmError as error:
        assert str(error).isprintable()


@pytest.mark.parametrize("encoding", ["ros2msg", "ros2idl"])
@BRIEF
@given(words=st.lists(WORDS, max_size=40))
def test_any_words_are_a_definition_or_refused(encoding: str, words: list[str]) -> None:
    """Any words of the two languages in any order."""
    try:
        assert isinstance(parse_definition("a/msg/T", encoding, " ".join(words)), dict)
    except ElasticArmError as error:
        assert str(error).isprintable()
