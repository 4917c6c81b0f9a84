"""What the selected effects amount to: estimates, lack of fit, size of the gap, agreement across recordings."""
