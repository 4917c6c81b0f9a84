"""An MJCF file with changed numbers that keeps its form: lxml trees of the file and includes."""

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from elastic_arm.errors import RobotError
from elastic_arm.input_files import read_bytes
from elastic_arm.mujoco.shape import ShapedXml, insert_first
from elastic_arm.output_files import write_result

FOLDERS = ("meshdir", "texturedir", "assetdir")


class ShapedMjcf:
    """The trees of an MJCF and of all that it includes."""

    def __init__(self, path: Path, text: str | None = None) -> None:
        self._path = path
        self._trees: dict[Path, ShapedXml] = {}
        self._changed: set[Path] = set()
        self._load(path, text)
        self.bodies = [element for element in self._walk(path) if element.tag == "body"]

    def lines_of(self, names: Sequence[str], places: Sequence[int], count: int) -> list[Any] | None:
        """Return the elements of some bodies, or None where one has none: <attach> and <replicate>
        make bodies too."""
        if len(self.bodies) == count:
            return [self.bodies[place - 1] for place in places]
        same = [
            [element for element in self.bodies if element.get("name") == name] for name in names
        ]
        return [found[0] for found in same] if all(len(found) == 1 for found in same) else None

    def elements(self, tag: str) -> Iterator[Any]:
        """Yield all elements of a name, of all files."""
        for tree in self._trees.values():
            yield from tree.root.iter(tag)

    def children(self, body: Any, tag: str) -> list[Any]:
        """Return what stands in a body and not in one of its bodies, includes and frames opened."""
        return [element for element in self._walk_in(body) if element.tag == tag]

    def set(self, element: Any, **values: str | None) -> None:
        """Set attributes, or take them away where they are None; the file counts as changed."""
        for name, value in values.items():
            if value is not None:
                element.set(name, value)
            elif name in element.attrib:
                del element.attrib[name]
        self._touch(element)

    def insert_first(self, parent: Any, tag: str) -> Any:
        """Insert an element as the first child, on a line of its own."""
        element = insert_first(parent, tag)
        self._touch(parent)
        return element

    def remove(self, element: Any) -> None:
        """Take an element away."""
        self._touch(element)
        element.getparent().remove(element)

    @property
    def root(self) -> Any:
        """The main file's first element."""
        return self._trees[self._path].root

    def write(self, out: Path) -> list[Path]:
        """Write the file, beside it what it includes and was changed, and return all that was
        written.

        Paths in it are changed so that meshes are found where they are.
        """
        out.parent.mkdir(parents=True, exist_ok=True)
        elsewhere = out.parent.resolve() != self._path.parent.resolve()
        if elsewhere:
            self._point_back(out.parent)
        return self._write(self._path, out, out, elsewhere)

    def _write(self, source: Path, target: Path, main: Path, elsewhere: bool) -> list[Path]:
        tree = self._trees[source]
        written = []
        for include in tree.root.iter("include"):
            file = self._included(include)
            if self._needs_copy(file, elsewhere):
                name = f"{main.stem}_{file.name}"
                written += self._write(file, main.parent / name, main, elsewhere)
                include.set("file", name)
            elif elsewhere:
                include.set("file", _relative(file, main.parent))
        return [write_result(target, tree.text()), *written]

    def _needs_copy(self, file: Path, elsewhere: bool) -> bool:
        inner = list(self._trees[file].root.iter("include"))
        return file in self._changed or any(
            elsewhere or self._needs_copy(self._included(include), elsewhere) for include in inner
        )

    def _point_back(self, folder: Path) -> None:
        """Let folders and files that the model names be found from another folder."""
        compilers = list(self.elements("compiler"))
        named = {name for compiler in compilers for name in FOLDERS if compiler.get(name)}
        for compiler in compilers:
            for name in FOLDERS:
                if compiler.get(name) and not Path(compiler.get(name)).is_absolute():
                    self.set(
                        compiler,
                        **{name: _relative(self._path.parent / compiler.get(name), folder)},
                    )
        files = {
            tag
            for tag in ("mesh", "texture", "hfield", "skin")
            for e in self.elements(tag)
            if e.get("file")
        }
        if files and "assetdir" not in named and not {"meshdir", "texturedir"} <= named:
            compiler = compilers[0] if compilers else self.insert_first(self.root, "compiler")
            here = _relative(self._path.parent, folder)
            self.set(
                compiler, **{name: here for name in ("meshdir", "texturedir") if name not in named}
            )
        for model in self.elements("model"):
            if model.get("file"):
                self.set(model, file=_relative(self._path.parent / model.get("file"), folder))

    def _touch(self, element: Any) -> None:
        root = element.getroottree().getroot()
        self._changed |= {path for path, tree in self._trees.items() if tree.root is root}

    def _load(self, path: Path, text: str | None = None) -> None:
        read = (
            read_bytes(path, RobotError, "Give an MJCF file with its included files.")
            if text is None
            else text.encode()
        )
        self._trees[path] = ShapedXml(read, str(path))
        for include in self._trees[path].root.iter("include"):
            file = self._included(include)
            if file not in self._trees:
                self._load(file)

    def _included(self, include: Any) -> Path:
        # MuJoCo looks for included files beside the main one.
        return self._path.parent / str(include.get("file"))

    def _walk(self, path: Path) -> Iterator[Any]:
        root = self._trees[path].root
        for child in root:
            if child.tag == "worldbody":
                yield from self._bodies_in(child)
            elif child.tag == "include":
                yield from self._walk(self._included(child))

    def _bodies_in(self, element: Any) -> Iterator[Any]:
        for child in element:
            if child.tag == "body":
                yield child
                yield from self._bodies_in(child)
            elif child.tag == "frame":
                yield from self._bodies_in(child)
            elif child.tag == "include":
                yield from self._bodies_in(self._trees[self._included(child)].root)

    def _walk_in(self, element: Any) -> Iterator[Any]:
        for child in element:
            if child.tag == "frame":
                yield from self._walk_in(child)
            elif child.tag == "include":
                yield from self._walk_in(self._trees[self._included(child)].root)
            elif isinstance(child.tag, str):
                yield child


def _relative(path: Path, folder: Path) -> str:
    return os.path.relpath(path.resolve(), folder.resolve())
