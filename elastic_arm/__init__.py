"""Robot arms with elastic joints: emulate, record, identify, and find where and why a model and an
arm differ.

    import elastic_arm as ea

    robot = ea.load_robot("arm.urdf")
    run_1, run_2 = ea.read_recording("run_1"), ea.read_recording("run_2")
    found = ea.diagnose(run_1, ea.Question(robot), run_2)

Names are loaded when they are first used.
"""

from typing import TYPE_CHECKING

from elastic_arm.lazy_names import lazily
from elastic_arm.version import __version__

if TYPE_CHECKING:
    from elastic_arm.diagnosis import Diagnosis, Question, diagnose, follow_up
    from elastic_arm.excitation import load_trajectory
    from elastic_arm.identification import Identification, IdentificationSettings, identify
    from elastic_arm.recording import Recording, Side, read_recording, write_recording
    from elastic_arm.robot import Robot, load_robot, save_robot
    from elastic_arm.simulation import SimulationSettings, simulate

__all__ = [
    "Diagnosis",
    "Identification",
    "IdentificationSettings",
    "Question",
    "Recording",
    "Robot",
    "Side",
    "SimulationSettings",
    "__version__",
    "diagnose",
    "follow_up",
    "identify",
    "load_robot",
    "load_trajectory",
    "read_recording",
    "save_robot",
    "simulate",
    "write_recording",
]

_MODULES = {
    **dict.fromkeys(("Diagnosis", "Question", "diagnose", "follow_up"), "elastic_arm.diagnosis"),
    **dict.fromkeys(
        ("Identification", "IdentificationSettings", "identify"), "elastic_arm.identification"
    ),
    **dict.fromkeys(
        ("Recording", "Side", "read_recording", "write_recording"), "elastic_arm.recording"
    ),
    **dict.fromkeys(("Robot", "load_robot", "save_robot"), "elastic_arm.robot"),
    **dict.fromkeys(("SimulationSettings", "simulate"), "elastic_arm.simulation"),
    "load_trajectory": "elastic_arm.excitation",
}

__getattr__, __dir__ = lazily(__name__, _MODULES)
