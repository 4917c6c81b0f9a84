"""MuJoCo as a user of models: corrected files, laws by callbacks, and replays of recordings."""

from elastic_arm.mujoco.callbacks import Attachment, attach
from elastic_arm.mujoco.mjcf_export import Exported, export_mjcf
from elastic_arm.mujoco.new_model import export_new_mjcf, to_mjcf
from elastic_arm.mujoco.recorder import record
from elastic_arm.mujoco.replaying import Replay, replay
from elastic_arm.mujoco.urdf_file import export_urdf
from elastic_arm.mujoco.usd_file import export_usd

__all__ = [
    "Attachment",
    "Exported",
    "Replay",
    "attach",
    "export_mjcf",
    "export_new_mjcf",
    "export_urdf",
    "export_usd",
    "record",
    "replay",
    "to_mjcf",
]
