"""The tree of links and joints of a URDF, and the branch that is the arm, without grippers."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator

from elastic_arm.errors import RobotError
from elastic_arm.robot.urdf_elements import attribute, by_name, child_of, number

Chain = tuple[str, str]

# What may stand in one file: far beyond any robot, and little enough for trees to be walked by
# recursion.
MOST_LINKS = 1000
DEEPEST = 200


class UrdfTree:
    """Links and joints of a URDF, checked to be one tree."""

    def __init__(self, root_element: ET.Element, chain: Chain | None = None) -> None:
        self.links = by_name(root_element, "link")
        self.joints = by_name(root_element, "joint")
        self.children: dict[str, list[ET.Element]] = {name: [] for name in self.links}
        self.parent_joint: dict[str, str] = {}
        if len(self.links) > MOST_LINKS:
            raise RobotError(
                f"the file has {len(self.links)} links; the limit is {MOST_LINKS}",
                "Remove the environment",
            )
        self._connect()
        self.root = self._only_root()
        if (deepest := max(map(len, map(self.path_to, self.links)))) > DEEPEST:
            raise RobotError(
                f"{deepest} joints in a row; the limit is {DEEPEST}", "Merge fixed links"
            )
        self.first = self.root
        self.held: set[str] = set()
        self.left_out: set[str] = set()
        if chain is None:
            self._hold_grippers()
        else:
            self.first = chain[0]
            self._cut(chain)

    def parent_of(self, joint: str) -> str:
        """Return the link that carries a joint."""
        return attribute(child_of(self.joints[joint], "parent", joint), "link", joint)

    def child_of(self, joint: str) -> str:
        """Return the link that a joint moves."""
        return attribute(child_of(self.joints[joint], "child", joint), "link", joint)

    def moves(self, joint: str) -> bool:
        """Whether a joint is one of the arm's own."""
        return self.joints[joint].get("type") != "fixed" and joint not in self.held

    def path_to(self, link: str) -> list[str]:
        """Return the joints from the root to a link."""
        path = []
        while link in self.parent_joint:
            path.append(self.parent_joint[link])
            link = self.parent_of(path[-1])
        return path[::-1]

    def links_from(self, joint: str) -> Iterator[str]:
        """Yield the link that a joint moves and all links that stand on it."""
        links = [self.child_of(joint)]
        for link in links:
            yield link
            links += [self.child_of(str(element.get("name"))) for element in self.children[link]]

    def mass_of(self, links: set[str]) -> float:
        """Return the sum of the masses that links state, kg."""
        masses = (self.links[link].find("inertial/mass") for link in links)
        return sum(number(mass.get("value", "0"), "mass") for mass in masses if mass is not None)

    def notes(self) -> list[str]:
        """Return what of the tree is read otherwise than written."""
        notes = []
        if self.held:
            mass = self.mass_of({link for joint in self.held for link in self.links_from(joint)})
            notes.append(
                f"joints {', '.join(sorted(self.held))} mimic one another like those of a"
                f" gripper: they are fixed at zero, and their links ({mass:.3g} kg) are part of"
                " the link that carries them"
            )
        if self.left_out:
            links = {link for joint in self.left_out for link in self.links_from(joint)}
            notes.append(
                f"links {', '.join(sorted(links))} ({self.mass_of(links):.3g} kg) are not part"
                " of the chain"
            )
        return notes

    def _connect(self) -> None:
        for name, element in self.joints.items():
            parent = self.parent_of(name)
            child = self.child_of(name)
            for link in (parent, child):
                if link not in self.links:
                    raise RobotError(
                        f"joint {name!r} refers to the link {link!r}, which does not exist",
                        "Correct the name",
                    )
            if child in self.parent_joint:
                raise RobotError(
                    f"link {child!r} is the child of joints {self.parent_joint[child]!r} and"
                    f" {name!r}",
                    "A serial arm has no loops: remove one of the joints",
                )
            self.parent_joint[child] = name
            self.children[parent].append(element)

    def _only_root(self) -> str:
        roots = [name for name in self.links if name not in self.parent_joint]
        if len(roots) != 1:
            which = ", ".join(roots) or "none"
            raise RobotError(
                f"there must be one root link, but the file has {len(roots)} ({which})",
                "Connect the links",
            )
        reached = {
            roots[0],
            *(link for element in self.children[roots[0]] for link in self._below(element)),
        }
        if loop := sorted(set(self.links) - reached):
            raise RobotError(
                f"links {', '.join(loop)} form a loop", "Connect the links to the root as a chain"
            )
        return roots[0]

    def _below(self, element: ET.Element) -> Iterator[str]:
        return self.links_from(str(element.get("name")))

    def _hold_grippers(self) -> None:
        """Hold the joints that mimic a joint beside them, or one that is held, the mimicked ones,
        and what they carry.

        A joint that mimics one before it in the chain is a coupled arm's, not a gripper's, and
        stays.
        """
        leaders = {
            name: str(mimic.get("joint"))
            for name, element in self.joints.items()
            if (mimic := element.find("mimic")) is not None
        }
        pending = {name: leader for name, leader in leaders.items() if leader in self.joints}
        while True:
            found = {
                name: leader
                for name, leader in pending.items()
                if leader in self.held or self._body_before(name) == self._body_before(leader)
            }
            if not found:
                return
            for name in {*found, *found.values()}:
                below = {self.parent_joint[link] for link in self.links_from(name)}
                self.held |= {joint for joint in below if self.joints[joint].get("type") != "fixed"}
            pending = {name: leader for name, leader in pending.items() if name not in found}

    def _body_before(self, joint: str) -> str:
        """Return the first link of the rigid body that carries a joint."""
        link = self.parent_of(joint)
        while (
            link in self.parent_joint
            and self.joints[self.parent_joint[link]].get("type") == "fixed"
        ):
            link = self.parent_of(self.parent_joint[link])
        return link

    def _cut(self, chain: Chain) -> None:
        first, last = chain
        for link in chain:
            if link not in self.links:
                raise RobotError(
                    f"chain {first}:{last}: unknown link {link!r}", "Give two links of the URDF"
                )
        path = self.path_to(last)
        begin = self.path_to(first)
        if path[: len(begin)] != begin or len(path) == len(begin):
            raise RobotError(
                f"chain {first}:{last}: {last!r} is not a descendant of {first!r}",
                "Give base and tip in this order",
            )
        on_path = set(path[len(begin) :])
        links = [first]
        for link in links:
            for element in self.children[link]:
                name = str(element.get("name"))
                # What is fixed to a link before the last is part of its body.
                if name not in on_path and (link == last or element.get("type") != "fixed"):
                    self.left_out.add(name)
                else:
                    links.append(self.child_of(name))
