"""What the scripts have in common that measure, or make a page of docs/ and its plots from a file of results."""

import array
import datetime
import json
import os
import platform
import sys
from pathlib import Path

TOOLS = Path(__file__).resolve().parent
DOCS = TOOLS.parent / "docs"
IMAGES = DOCS / "images"


def load(name, kinds):
    """The results of docs/NAME.json: a list for each kind, empty where there are none yet."""
    path = DOCS / f"{name}.json"
    return {kind: [] for kind in kinds} | (json.loads(path.read_text()) if path.exists() else {})


def utc_now():
    return datetime.datetime.now(datetime.timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def facts_of_run():
    """When it was and on what machine, with the load that everybody there makes."""
    return {"date": utc_now(), "host": platform.processor() or platform.machine(),
            "processors": len(os.sched_getaffinity(0)), "load": os.getloadavg()[0]}


def fresh_process(start, command, limit, folder):
    """A command in a process of its own: what start(list) returns that runs it, its `seconds` and its `peak_bytes`."""
    result = folder / "fresh.json"
    done = start([sys.executable, TOOLS / "peers/fresh_process.py", result, limit, *command])
    return done, json.loads(result.read_text())


def read_pfm(path):
    """Floats of a little-endian RGB PFM, rows from the bottom."""
    with open(path, "rb") as file:
        if file.readline().strip() != b"PF":
            raise ValueError(f"{path} is no colour PFM")
        file.readline(), file.readline()
        return floats_of(file.read())


def floats_of(data):
    """Of little-endian bytes."""
    values = array.array("f")
    values.frombytes(data)
    if sys.byteorder == "big":
        values.byteswap()
    return values


def film_seconds(phases, which):
    """Seconds from a loaded scene to the film on the host, of the phases that rt bench tells; `which`: min, median or max
    of each phase's repeats."""
    return sum(phases[part][which] for part in ("upload", "launches", "read_back", "rest"))


def keep(name, results, page):
    (DOCS / f"{name}.json").write_text(json.dumps(results, indent="\t") + "\n")
    (DOCS / f"{name}.md").write_text(page)


def check(name, page):
    """Ends the script unless the page is what its results make."""
    if (DOCS / f"{name}.md").read_text() != page:
        sys.exit(f"docs/{name}.md is not what docs/{name}.json says: run tools/plot_{name}.py")


def picked(document, keys):
    return {key: document[key] for key in keys if key in document}


def replace(entries, entry, key):
    """Puts the entry in the place of the older one with its key."""
    entries[:] = [other for other in entries if key(other) != key(entry)] + [entry]
    entries.sort(key=lambda other: tuple(map(str, key(other))))


def pyplot_of_house():
    import matplotlib
    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.hashsalt": "rt", "svg.fonttype": "none", "font.size": 9})
    from matplotlib import pyplot
    return pyplot


def save(pyplot, figure, path):
    """Without a date, so that the same results give the same file."""
    figure.savefig(path, metadata={"Date": None} if str(path).endswith(".svg") else None)
    pyplot.close(figure)
