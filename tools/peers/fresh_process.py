"""Runs a command and writes how long it took and how much memory it had at most: tools/bench_peers starts it.

    fresh_process.py RESULT.json SECONDS COMMAND [ARGUMENT]...      (tools/bench_start does, too)

A process of its own does so, because Linux counts what a parent has in memory as its child's, too: this one is small.
Exit status: the command's; 124 if it took longer than SECONDS and was ended.
"""

import json
import resource
import subprocess
import sys
import threading
import time


def main():
    result, limit, command = sys.argv[1], float(sys.argv[2]), sys.argv[3:]
    late = threading.Event()

    def end():
        late.set()
        process.kill()

    start = time.perf_counter()
    try:
        process = subprocess.Popen(command)
    except FileNotFoundError:
        sys.exit(f"{command[0]} was not found")
    # Not wait(timeout), which looks every 50 ms.
    timer = threading.Timer(limit, end)
    timer.start()
    status = process.wait()
    seconds = time.perf_counter() - start
    timer.cancel()
    if late.is_set():
        print(f"no result within {sys.argv[2]} s", file=sys.stderr)
        sys.exit(124)
    with open(result, "w") as file:
        json.dump({"seconds": seconds, "peak_bytes": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024},
                  file)
    sys.exit(status if status >= 0 else 128 - status)


main()
