"""Whether a recording is sound: what a bag holds, what is wrong with it, what can be repaired."""
