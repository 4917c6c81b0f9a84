"""From numbers, laws and sensors to residuals and columns of a recording."""
