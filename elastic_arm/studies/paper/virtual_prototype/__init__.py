"""The paper's virtual prototype, built in MuJoCo: an engine that nobody here wrote."""
