"""The paper's claims, each with its verdict on our numbers."""
