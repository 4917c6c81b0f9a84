"""All parameters, physically consistent: coordinates near the description, the fit in them, and the arm found."""
