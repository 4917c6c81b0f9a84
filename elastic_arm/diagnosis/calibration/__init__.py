"""What is ordinarily imperfect, marginalised: nuisance parameters, their columns, and where they lie most probably."""
