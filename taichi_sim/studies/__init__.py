"""Engine of all studies (report, tune, sweep, fit): the folder that keeps what was run, its records, pages and figures."""
