"""Speed against error: what a simulated second costs with each method, step and precision, and how far the result is off."""
