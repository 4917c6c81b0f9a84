"""The meanings of the columns in reports, with the terms of docs/glossary.md."""

MEANINGS = {
    "cause": "effect, or large deviation of a parameter, that the arm has and the model lacks",
    "where": "the joint of the cause",
    "visible on": "equations of the joint in which the cause is visible: link, drive or motor side",
    "size": "parameters of the cause with one standard deviation; from → to if the description"
    " states a value",
    "share of the gap": "share of the whole gap that this cause alone removes",
    "probability": "probability that the cause is present, given the recordings and its prior",
    "named cause": "cause for which there is an alternative",
    "alternative": "another effect that fits nearly as well",
    "separated by": "file of a motion to record, or another way to separate the two",
    "side": "equation of a joint: link, drive or motor",
    "compares": "the two sides of the equation",
    "residual": "measured value minus the value of the model; symbols in docs/notation.md",
    "regime": "quantity on which the residual depends",
    "remaining": "root mean square of the residual with all causes",
    "number": "parameter of the arm or of a sensor",
    "value": (
        "estimate: a ratio to the description without a unit, a difference from it with a unit"
    ),
    "± std": "one standard deviation",
    "prior std": "usual deviation of such a parameter, one standard deviation",
    "usual": "whether the deviation is usual for an arm",
    "noise": "standard deviation of the sensor noise in the residual",
    "rmse": "root mean square of the residual",
    "rmse before": "root mean square of the residual of the uncorrected model",
    "rmse after": "the same with all causes",
    "max": "largest residual",
    "max before": "largest residual of the uncorrected model",
    "max after": "the same with all causes",
    "own gap": "removed share of the power of this residual above the noise",
    "angle": "motor angle or link angle",
    "this recording": "log-likelihood ratio between the two in the recording",
    "proposed motion": "the same, expected for the proposed motion",
    "expected to separate": "whether this ratio is sufficient",
    "parameter": "combination that the equations determine, named by its first term; in full below",
    "identified": "value with the best fit to the recordings",
    "nominal": "value of the description",
    "determined": (
        "whether the standard deviation is small compared with the usual size of such a"
        " parameter for this arm"
    ),
    "equation": "compared side of the joint, or compared torque",
    "arm": "nominal, identified, or consistent (physically possible parameters)",
    "recording": "held-out data",
}


def meaning(heading: str) -> str:
    """Return what a column means; empty where its heading is a name or states it."""
    return MEANINGS.get(heading.partition(",")[0], "")
