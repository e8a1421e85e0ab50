"""Many runs: sweeps of parameters and seeds, and fits, on the cores of this machine or a cluster."""
