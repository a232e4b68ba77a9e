"""A thread that plays the other end of a wire."""

import threading


class Served:
    """Serves in a thread of its own while it is entered."""

    def __init__(self):
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()
        self.close()

    def _run(self):
        while not self._stop.is_set():
            self.serve()

    def serve(self):
        """Wait for a moment, and answer what has come."""
        raise NotImplementedError

    def close(self):
        """Take the ports away."""
        raise NotImplementedError
