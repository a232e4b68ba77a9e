"""Files that are meant to do harm, and how much memory a program takes for them."""

import struct
import subprocess
import sys
import zlib


def png_of_zeros(width: int, height: int) -> bytes:
    """Return a black picture of one bit a pixel, in hardly any bytes."""
    row = bytes(1 + -(-width // 8))
    packer = zlib.compressobj(9)
    data = b"".join(packer.compress(row * 100) for _ in range(height // 100 + 1)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 1, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in chunks
    )


_PEAK = """
def peak():
    lines = open("/proc/self/status").read().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024

"""


def run_and_weigh(imports: str, program: str) -> tuple[str, float]:
    """Run a program in a process of its own.

    Its peak is the kernel's VmHWM: `ru_maxrss` begins with the peak of the process that started it.

    Args:
        imports: Lines before the memory is measured.
        program: Lines whose memory is measured.

    Returns:
        What it printed, and by how much its peak memory grew [MB].
    """
    text = f"{_PEAK}{imports}\nbefore = peak()\n{program}\nprint(peak() - before)"
    words = [sys.executable, "-c", text]
    done = subprocess.run(words, check=False, capture_output=True, text=True, timeout=100)
    assert done.returncode == 0, done.stderr
    *lines, grown = done.stdout.splitlines()
    return "\n".join(lines), float(grown)
