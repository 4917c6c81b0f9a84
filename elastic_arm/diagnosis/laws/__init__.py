"""Laws that no catalogue states, with which the causes are compared."""
