"""The arms of the challenge, simulated independently, without laws and models of the suite."""
