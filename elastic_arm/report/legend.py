"""What the columns of reports mean: one word for one thing, as in docs/glossary.md."""

MEANINGS = {
    "cause": "effect, or number far off, that the arm has and the model lacks",
    "where": "the joint that has it",
    "shows on": "equations of the joint in which it shows: link, drive or motor side",
    "size": "its numbers, with one standard deviation; from → to where the description states one",
    "share of the gap": "what goes of the whole gap when this cause alone is added",
    "probability": "that it is there, by the recordings and by how common it is",
    "instead of": "the cause that the line is about",
    "it may be": "another effect that fits nearly as well",
    "told apart by": "file of a motion to record, or what else would decide",
    "side": "which of the equations of a joint: link, drive or motor",
    "compares": "what the equation sets against each other",
    "residual": "what is measured less what the model gives; symbols in docs/notation.md",
    "follows": "what the residual changes with",
    "left": "root mean square of what remains with all causes added",
    "number": "a number of the arm or of a sensor",
    "value": (
        "as found: a ratio to the description where there is no unit, else a difference from it"
    ),
    "± std": "one standard deviation",
    "prior std": "how far off such a number usually is, one standard deviation",
    "usual": "whether it is no further off than is usual of an arm",
    "noise": "standard deviation of the sensors' noise in the residual",
    "rmse": "root mean square of the residual",
    "rmse before": "root mean square of the residual of the model as it is",
    "rmse after": "the same with all causes added",
    "max": "largest residual",
    "max before": "largest residual of the model as it is",
    "max after": "the same with all causes added",
    "own gap": "share of this residual's power over the noise that is gone",
    "angle": "motor angle or link angle",
    "alternative": "what may be there instead of the cause",
    "this recording": "log-likelihood by which the recording tells the two apart",
    "proposed motion": "the same, expected of the proposed motion",
    "expected to decide": "whether that is enough",
    "parameter": "combination that the equations determine, by its first term; in full below",
    "identified": "value that fits the recordings best",
    "nominal": "value of the description",
    "determined": (
        "whether the standard deviation is small against what such a number has of this arm"
    ),
    "equation": "side of the joint, or torque, that is compared",
    "arm": "nominal, identified, or consistent (numbers that bodies can have)",
    "recording": "data that no fit has seen",
}


def meaning(heading: str) -> str:
    """Return what a column means; empty where its heading is a name or states it."""
    return MEANINGS.get(heading.partition(",")[0], "")
