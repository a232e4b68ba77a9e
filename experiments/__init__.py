"""One experiment for each result of the thesis, and the command line that runs them."""
