"""The words of a diagnosis: numbers as text, the notes of its steps, and the sentences on its result."""
