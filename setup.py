"""ROS package `elastic_arm` (ament_python), installable with plain pip as well."""

from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "elastic_arm"
VERSION = next(
    line.split('"')[1]
    for line in Path(NAME, "version.py").read_text().splitlines()
    if line.startswith("__version__")
)
NODES = ("simulator", "trajectory_generator", "identifier", "gap_monitor", "recorder", "replayer")


# What the library and most commands need at run time, from the oldest versions that it is tested
# with (`make oldest`) or known to need. The pins of requirements.txt belong to the project's own
# environment.
LIBRARIES = (
    "casadi>=3.7",
    "clarabel>=0.9",
    "cvxpy-base>=1.6",
    "h5py>=3.10",
    "jinja2>=3.1.2",
    "lxml>=5.2",
    "lz4>=4.0.2",
    "matplotlib>=3.6",
    "mcap>=1.6",
    "mujoco>=4.0",
    "numpy>=1.26",
    "platformdirs>=4.2",
    "pydantic>=2.6",
    "PyNomadBBO>=4.5",
    "python-dateutil>=2.8.2",
    "pyyaml>=6.0.1",
    "rich>=13.8",
    "rosbags>=0.11",
    "scipy>=1.11",
    "threadpoolctl>=3.1",
    "typer>=0.29",
    "xacro>=2.0",
    "zstandard>=0.22",
)
# Large libraries that few commands need: Pinocchio with all it brings takes 350 MB, PyArrow 170.
# `elastic_arm.errors.EXTRAS` names the extra where one is missing.
EXTRAS = {
    "challenge": ["pin>=2.7"],
    "learning": ["pyarrow>=17"],
    "paper": ["sympy>=1.12"],
}


setup(
    name=NAME,
    version=VERSION,
    description=(
        "Elastic-joint robot arms: emulate, record, identify, and say where and why model and robot"
        " differ."
    ),
    # colcon runs a link to this file in a folder of its own.
    long_description=Path(__file__).resolve().with_name("README.md").read_text(encoding="utf-8"),
    long_description_content_type="text/markdown",
    license="Apache-2.0",
    maintainer="elastic_arm maintainers",
    maintainer_email="maintainers@users.noreply.h-seed-cf1e5b97.example",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: [
            f"**/*.{kind}"
            for kind in ("yaml", "html", "xml", "j2", "css", "js", "msg", "c", "h", "typed")
        ]
    },
    python_requires=">=3.11",
    install_requires=list(LIBRARIES),
    extras_require={
        "test": ["pytest", "pytest-xdist", "hypothesis"],
        "notebook": ["pandas"],
        "usd": ["usd-core"],
        "cluster": ["distributed"],
        **EXTRAS,
        "all": [library for libraries in EXTRAS.values() for library in libraries],
        "mujoco": [],  # every installation has it; the name stays for whoever asks by it
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", sorted(glob("launch/*.launch.py"))),
        (f"share/{NAME}/config", sorted(glob("config/*.yaml"))),
        (f"share/{NAME}/layouts", sorted(glob("layouts/*"))),
    ],
    entry_points={
        "console_scripts": [
            "elastic-arm = elastic_arm.app:main",
            *(f"{node} = {NAME}.nodes.entry:{node}" for node in NODES),
        ]
    },
    zip_safe=True,
)
