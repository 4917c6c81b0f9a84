"""The paper's study: a virtual prototype in a physics engine that nobody here wrote, the figures,
and the claims."""
