"""One file a thesis result, the command line and the report."""
