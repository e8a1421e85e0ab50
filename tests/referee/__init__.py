"""The referee: random scenes, judged by relations that hold without a reference. `python -m tests.referee --help`."""
