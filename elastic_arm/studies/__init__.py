"""Studies made with the suite: the paper, and the blind challenge of the diagnosis. Nothing imports
this package."""
