#!/usr/bin/env python3
"""Makes docs/performance.md and its plots from the results in docs/performance.json.

    tools/plot_performance.py --add FILE...    takes up results of `rt bench --json`, with or without --sweep, of
                                               `tools/bench_peers --json`, `tools/bench_crossover --json`,
                                               `tools/bench_start --json` and `tools/measure_mean --json`, and the text
                                               of build/tools/rt_measure_rungs, in the place of older ones of the same
                                               device and kind; then makes page and plots
    tools/plot_performance.py --profile FILE DATE DEVICE WHAT
                                               takes up the text of Nsight Compute (ncu --set full) about one launch;
                                               WHAT says of what
    tools/plot_performance.py                  makes page and plots
    tools/plot_performance.py --check          is the page what the results say? (without plots, so no matplotlib)

Needs matplotlib for the plots.
"""

import argparse
import datetime
import json
import re
import sys
from pathlib import Path

from results_page import IMAGES, check, film_seconds, keep, load, picked, pyplot_of_house, replace, save

SWEEPS = {
    "pixels": "pixels of the image",
    "samples": "samples a pixel",
    "spheres": "spheres of a cloud",
    "depth": "most scatterings of a path",
    "threads": "threads",
}
# Of each measurement only what the page needs, so that the file stays small.
POINT_KEYS = ("x", "scene", "spheres", "width", "height", "samples", "max_depth", "load_seconds", "pack_seconds",
              "bvh_seconds", "render_seconds", "segments_rendered", "segments_per_second", "bvh", "film_hash")
BENCH_KEYS = ("scene", "spheres", "width", "height", "samples", "max_depth", "load_seconds", "pack_seconds", "first",
              "phases", "render_seconds", "samples_per_second", "segments_per_second", "segments_rendered", "launches",
              "lanes", "bvh", "build", "model", "peak", "film_hash", "seconds")
# Steps are written by hand: what, before, after, where, date.
KINDS = ("peers", "sweeps", "benches", "rungs", "crossovers", "means", "starts", "profiles", "steps")
# What is said of a profiled launch: Nsight Compute's name, ours, and the unit.
METRICS = (("Duration", "duration", " ms"), ("Executed Instructions", "warp instructions", ""),
           ("Issue Slots Busy", "issue slots busy", " %"),
           ("Avg. Active Threads Per Warp", "active lanes of a warp's 32", ""),
           ("Avg. Not Predicated Off Threads Per Warp", "of which not predicated off", ""),
           ("Branch Efficiency", "branches that the whole warp takes alike", " %"),
           ("Eligible Warps Per Scheduler", "warps ready to issue, a scheduler", ""),
           ("Registers Per Thread", "registers a work-item", ""),
           ("Theoretical Occupancy", "occupancy that registers allow", " %"),
           ("Achieved Occupancy", "occupancy achieved", " %"),
           ("Local Memory Spilling Requests", "spills", ""), ("L1/TEX Hit Rate", "L1 hits", " %"))
FACTS = ("version", "revision", "contract", "precision", "date", "threads", "repeats")


# ---- results --------------------------------------------------------------------------------------------------------


def device_of(document):
    return {key: document["device"][key] for key in ("backend", "name", "driver", "compute_units")}


def add(results, document, path):
    """Puts a result in, in the place of an older one of its kind."""
    if "cases" in document:
        for case in document["cases"]:
            entry = {**picked(document, ("date", "host", "processors", "load", "slope_of_fuzz")), **case}
            rt = [row for row in case["rows"] if row["peer"].startswith("rt ") and "device" in row]
            entry["device"] = rt[0]["device"] if rt else ""
            # A run without rt says nothing of its device: it gives way to any other.
            results["peers"] = [other for other in results["peers"] if other["device"] or other["case"] != case["case"]]
            replace(results["peers"], entry, lambda other: (other["case"], other["device"]))
    elif "sweep" in document:
        sweep = dict(document["sweep"])
        sweep["points"] = [picked({**point, "bvh_seconds": point["phases"]["bvh"]["min"]}, POINT_KEYS)
                           for point in sweep["points"]]
        entry = {**picked(document, FACTS), "device": device_of(document), **sweep}
        replace(results["sweeps"], entry, lambda other: (other["of"], other["device"]["backend"],
                                                         other["device"]["name"], other["precision"]))
    elif "crossover" in document:
        entry = {**document, "device": device_of(document)}
        replace(results["crossovers"], entry, lambda other: (other["device"]["backend"], other["device"]["name"]))
    elif "mean" in document:
        replace(results["means"], {"date": document["date"], **document["mean"]},
                lambda other: (other["scene"], other["backend"]))
    elif "starts" in document:
        for start in document["starts"]:
            entry = {**picked(document, ("date", "version", "revision", "device", "processors", "load", "rounds")),
                     **start}
            replace(results["starts"], entry, lambda other: (other["case"], other["device"]["backend"],
                                                             other["device"]["name"]))
    elif "phases" in document:
        document.setdefault("precision", "exact")  # results from before there was another
        entry = {**picked(document, FACTS), "device": device_of(document), **picked(document, BENCH_KEYS)}
        entry["build"] = picked(entry["build"], ("from_cache", "embedded", "variant", "kernels"))
        replace(results["benches"], entry,
                lambda other: (other["scene"], other["width"], other["device"]["backend"], other["device"]["name"],
                               other["precision"]))
    else:
        sys.exit(f"plot_performance: {path} is no result that is known")


def add_rungs(results, text, path, date):
    """Tables of build/tools/rt_measure_rungs; what a terminal was shown before them goes away."""
    head = re.compile(r"(\S+), (\d+x\d+), (\d+) samples a pixel, (.*) \((\w+)\), (\d+) rounds, differences from")
    entry = None
    for line in re.split(r"[\r\n]", text):
        line = re.sub(r"\x1b\[K", "", line)
        if match := head.search(line):
            entry = {"scene": match[1], "size": match[2], "samples": int(match[3]), "device": match[4],
                     "backend": match[5], "rounds": int(match[6]), "date": date, "of_exact": {}}
            replace(results["rungs"], entry, lambda other: (other["backend"], other["device"], other["scene"]))
        elif entry and (match := re.match(r"(exact|fast|double) +([\d.]+) +([\d.]+) ", line)):
            entry["of_exact"][match[1]] = float(match[3])
            if match[1] == "exact":
                entry["seconds"] = float(match[2])
    if not entry:
        sys.exit(f"plot_performance: {path} is no result that is known")


def add_profile(results, path, date, device, what):
    metrics = {}
    for line in Path(path).read_text().splitlines():
        for name, _, _ in METRICS:
            if match := re.match(rf" +{re.escape(name)} +(\S*?) +([\d.,]+)$", line):
                scale = {"ns": 1e-6, "us": 1e-3, "ms": 1, "s": 1e3}[match[1]] if name == "Duration" else 1
                metrics.setdefault(name, float(match[2].replace(",", "")) * scale)
    if not metrics:
        sys.exit(f"plot_performance: {path} has none of Nsight Compute's tables")
    replace(results["profiles"], {"date": date, "device": device, "what": what, "metrics": metrics},
            lambda other: (other["device"], other["what"]))


# ---- targets --------------------------------------------------------------------------------------------------------


class Measured(float):
    """A figure that knows where it was measured."""

    def __new__(cls, value, device, date, what=""):
        self = super().__new__(cls, value)
        self.where = f"{short_name(device)}, {date[:10]}" + (f": {what}" if what else "")
        return self


def short_name(device):
    """PoCL puts its scheduler and LLVM's name of the processor before the processor's own name."""
    name = re.sub(r"^pthread-[a-z0-9-]+-(?=[A-Z])", "PoCL, ", device)
    return name.replace("(R)", "").removesuffix(" Processor")


class Unknown(Exception):
    """Why a target cannot be judged from the results."""


def least(rows, peers, key="seconds"):
    known = [rows[peer] for peer in peers if peer in rows and key in rows[peer]]
    if not known:
        raise Unknown("the peer was not measured")
    return min(known, key=lambda row: row[key])


def own_row(rows, own, peer):
    """rt's row, of CUDA or on a processor, to compare a peer's with: with roulette where that has it."""
    plain = [name for name, row in rows.items()
             if name.startswith("rt cuda" if own == "rt cuda" else "rt ") and not row.get("mode")]
    mine = least(rows, plain, "seconds")
    return rows.get(f"{mine['peer']}, roulette", mine) if peer.endswith(", roulette") else mine


def is_gpu(entry):
    return any(row["peer"] == "rt cuda" and "skipped" not in row for row in entry["rows"])


def worst(of, measured):
    """Of what was measured the least or the largest; Unknown if nothing was."""
    if not measured:
        raise Unknown("not measured")
    return of(measured)


def against(case, peers, own="rt cuda", key="seconds"):
    """How many times rt's time, or what `key` says, these peers' is at least, on all devices of the kind of `own`."""
    def figure(results):
        measured = []
        for entry in results["peers"]:
            rows = {row["peer"]: row for row in entry["rows"] if "skipped" not in row}
            if entry["case"] != case or is_gpu(entry) != (own == "rt cuda"):
                continue
            pairs = [(own_row(rows, own, peer), rows[peer]) for peer in peers if key in rows.get(peer, {})]
            pairs = [(mine, peer) for mine, peer in pairs if key in mine]
            if pairs:
                mine, peer = min(pairs, key=lambda pair: pair[1][key] / pair[0][key])
                measured.append(Measured(peer[key] / mine[key], entry["device"], entry["date"],
                                         f"{mine['peer']} against {peer['peer']}" if len(peers) > 1 else ""))
        return worst(min, measured)
    return figure


def opencl_against_cuda(results):
    """Of the scenes that rt bench rendered through both, the same program on the same day: the worst, by the least times
    of films."""
    runs = {}
    for bench in results["benches"]:
        run = (*(bench.get(key) for key in ("scene", "width", "samples", "precision", "revision")),
               bench["device"]["name"], bench["date"][:10])
        runs.setdefault(run, {})[bench["device"]["backend"]] = bench
    ratios = []
    for run in runs.values():
        if "cuda" in run and "opencl" in run:
            cuda, opencl = run["cuda"], run["opencl"]
            launches = opencl["phases"]["launches"]["min"] / cuda["phases"]["launches"]["min"]
            ratios.append(Measured(film_seconds(opencl["phases"], "min") / film_seconds(cuda["phases"], "min"),
                                   cuda["device"]["name"], cuda["date"],
                                   f"rt bench, {cuda['scene']}; launches alone {launches:.2f}"))
    return worst(max, ratios)


def error_time(case):
    """How many times the best peer's error x time is that of rt's best row at least, on all processors."""
    def figure(results):
        measured = []
        for entry in results["peers"]:
            rows = {row["peer"]: row for row in entry["rows"] if "error_time" in row}
            if entry["case"] == case and not is_gpu(entry) and rows:
                own = [peer for peer in rows if peer.startswith("rt ")]
                mine = least(rows, own, "error_time")
                peer = least(rows, rows.keys() - set(own), "error_time")
                measured.append(Measured(peer["error_time"] / mine["error_time"], entry["device"], entry["date"],
                                         f"{mine['peer']} against {peer['peer']}"))
        return worst(min, measured)
    return figure


def sweep_points(results, backends):
    for sweep in results["sweeps"]:
        if sweep["of"] == "spheres" and sweep["precision"] == "exact" and sweep["device"]["backend"] in backends:
            return {point["x"]: point for point in sweep["points"]}, sweep
    raise Unknown("not measured")


def million_against_thousand(results):
    points, sweep = sweep_points(results, ("cuda",))
    if 1e6 not in points:
        raise Unknown("a million spheres were not measured")
    return Measured(points[1e6]["render_seconds"]["min"] / points[1e3]["render_seconds"]["min"],
                    sweep["device"]["name"], sweep["date"])


def million_tree_on_two(results):
    points, sweep = sweep_points(results, ("opencl", "reference"))
    if 1e6 not in points or sweep["threads"] != 2:
        raise Unknown("a million spheres were not measured with two threads")
    return Measured(points[1e6]["bvh_seconds"], sweep["device"]["name"], sweep["date"])


def million_mean(results):
    for entry in results["means"]:
        if entry["scene"] == "cloud-1000000":
            return Measured(abs(entry["relative_difference"]), entry["backend"], entry["date"])
    raise Unknown("not measured")


def start_seconds(case, backend, which):
    """Median seconds from the command line to the picture; the slowest device of that backend counts."""
    def figure(results):
        medians = [Measured(entry[which]["median"], entry["device"]["name"], entry["date"])
                   for entry in results["starts"]
                   if entry["case"] == case and entry["device"]["backend"] == backend
                   and is_processor(backend, entry["device"]["name"]) == (backend != "cuda")]
        return worst(max, medians)
    return figure


def exact_against_fast(backends):
    """The largest ratio among scenes; both rungs were rendered in turn."""
    def figure(results):
        ratios = [Measured(1 / entry["of_exact"]["fast"], entry["device"], entry["date"])
                  for entry in results["rungs"] if entry["backend"] in backends and "fast" in entry["of_exact"]
                  and is_processor(entry["backend"], entry["device"]) == ("cuda" not in backends)]
        return worst(max, ratios)
    return figure


def is_processor(backend, device):
    """OpenCL's GPUs share their backend with processors; they have CUDA's name too."""
    return backend != "cuda" and not device.startswith("NVIDIA")


CUDA = ["Mitsuba cuda_ad_rgb", "Mitsuba cuda_ad_rgb, roulette"]
LLVM = ["Mitsuba llvm_ad_rgb", "Mitsuba llvm_ad_rgb, roulette"]
CYCLES = ["Cycles", "Cycles, roulette"]
SMALL, LARGE = "three-spheres:640x360:32", "three-spheres:1920x1080:128"
STARTED = "three-spheres:640x480:16"
WEEKEND, LARGE_WEEKEND = "weekend:400x225:16", "weekend:1200x675:100"
CLOUDS = ["cloud-100000:400x225:16", "cloud-1000000:400x225:16"]
# What is promised, the bound, whether it is a floor or a ceiling, and how it is computed.
TARGETS = [
    (f"`{LARGE}`, CUDA, against the seed's program", 32, "at least", against(LARGE, ["seed's program"])),
    (f"`{LARGE}`, CUDA, against Mitsuba cuda", 60, "at least", against(LARGE, CUDA)),
    ("NVIDIA's OpenCL, time against CUDA, worst case", 1.05, "at most", opencl_against_cuda),
    (f"`{LARGE_WEEKEND}`, CUDA, against Mitsuba cuda", 8, "at least", against(LARGE_WEEKEND, CUDA)),
    ("`cloud-1000000:400x225:16`, CUDA, against Mitsuba cuda", 3, "at least",
     against("cloud-1000000:400x225:16", CUDA)),
    ("time of 10^6 spheres against 10^3, CUDA", 6, "at most", million_against_thousand),
    (f"`{SMALL}`, processor, against Mitsuba llvm", 8, "at least", against(SMALL, LLVM, "processor")),
    (f"`{SMALL}`, processor, against the book on one thread", 15, "at least",
     against(SMALL, ["book 1, one thread"], "processor")),
    (f"`{WEEKEND}`, processor, against Mitsuba llvm", 3, "at least", against(WEEKEND, LLVM, "processor")),
    (f"`{SMALL}`, processor, error x time of the best peer", 10, "at least", error_time(SMALL)),
    (f"`{WEEKEND}`, processor, error x time of the best peer", 10, "at least", error_time(WEEKEND)),
    ("seconds to build the tree of 10^6 spheres, two threads", 1, "at most", million_tree_on_two),
    ("mean of `cloud-1000000` against the double rung, relative difference", 1e-4, "at most", million_mean),
    *((f"`{cloud}`, {what} of Cycles' point cloud, times rt's on a processor", 2, "at least",
       against(cloud, CYCLES, "processor", key))
      for cloud in CLOUDS
      for what, key in (("time", "seconds"), ("fresh process", "command_seconds"), ("peak memory", "peak_bytes"))),
    (f"seconds from the command line to the PNG, `{STARTED}`, PoCL, empty caches", 3, "at most",
     start_seconds(STARTED, "opencl", "cold")),
    ("the same with full caches", 0.5, "at most", start_seconds(STARTED, "opencl", "warm")),
    ("the same, CUDA, full caches", 0.4, "at most", start_seconds(STARTED, "cuda", "warm")),
    ("seconds from the command line to the PNG, `cloud-1000000:400x225:16`, CUDA, empty caches", 2, "at most",
     start_seconds("cloud-1000000:400x225:16", "cuda", "cold")),
    ("time of exact over fast, CUDA, worst case", 1.25, "at most", exact_against_fast(("cuda",))),
    ("time of exact over fast, processor, worst case", 1.1, "at most", exact_against_fast(("opencl", "reference"))),
]


def verdicts(results):
    lines = ["| what | target | measured | | on |", "|---|---|---|---|---|"]
    for what, bound, sense, figure in TARGETS:
        try:
            value = figure(results)
            reached = value >= bound if sense == "at least" else value <= bound
            told, verdict, where = f"{value:.3g}", "reached" if reached else "**missed**", value.where
        except Unknown as reason:
            told, verdict, where = str(reason), "", ""
        lines.append(f"| {what} | {sense} {bound} | {told} | {verdict} | {where} |")
    return lines


def parts_of_render(results):
    """Where a GPU's time goes, beside the peers: what rt bench says of the same scenes on the same device."""
    rows = []
    for entry in results["peers"]:
        if not is_gpu(entry):
            continue
        scene, size, samples = entry["case"].split(":")
        benches = [bench for bench in results["benches"]
                   if (bench["scene"], f"{bench['width']}x{bench['height']}", str(bench["samples"]),
                       bench["device"]["name"], bench["device"]["backend"], bench["precision"])
                   == (scene, size, samples, entry["device"], "cuda", "exact")]
        others = [row for row in entry["rows"] if "skipped" not in row and not row["peer"].startswith("rt ")]
        mine = next(row for row in entry["rows"] if row["peer"] == "rt cuda")
        if benches and others:
            phases = benches[0]["phases"]
            film = film_seconds(phases, "min")
            rows.append((f"`{entry['case']}`", time_text(mine["seconds"]), time_text(film),
                         *(time_text(phases[key]["min"]) for key in ("launches", "upload", "read_back", "rest", "encode")),
                         *("; ".join(f"{row['peer']} {row['seconds'] / time:.1f}" for row in others)
                           for time in (mine["seconds"], film))))
    if not rows:
        return []
    head = ("case", "film, peers' run", "film, `rt bench`", "launches", "upload", "read back", "rest", "PNG",
            "peers' time, of the film of their run", "of `rt bench`'s film")
    return ["On a GPU the launches are a part only of a short render. *Film, peers' run*: from the loaded scene to the",
            "film on the host, as the peers are measured, in their run, and what the targets go by. *Film, `rt bench`* and",
            "its parts: least of the repeats, same kind of device, of the day and code that the benches below name. The last",
            "column therefore is of two runs: what to expect of the next one, and no target.", "",
            *table(head, rows), ""]


# ---- the page -------------------------------------------------------------------------------------------------------


def time_text(seconds):
    if seconds is None:
        return ""
    if seconds < 0.0995:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.3g} s"


def count_text(value):
    for size, letter in ((1e12, " T"), (1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.3g}"


def device_text(entry):
    device = entry["device"]
    rung = "" if entry["precision"] == "exact" else f", {entry['precision']}"
    return f"{device['name']} ({device['backend']}{rung})"


def peers_text(entry):
    rt = next((row for row in entry["rows"] if "device" in row), None)
    lines = [f"### {entry['case']}", ""]
    facts = [entry["date"][:10], f"{entry['processors']} processors", f"load average {entry['load']:.0f} at the end"]
    if rt:
        facts = [rt["device"], f"driver {rt['driver']}", f"rt {rt['version']}"] + facts
    if "slope_of_fuzz" not in entry and not entry["case"].startswith("cloud"):
        facts.append("Mitsuba's metals with the fuzz itself as slope")
    lines += ["; ".join(facts) + ".", ""]
    with_error = any("mse" in row for row in entry["rows"])
    # Entries from before rt's memory was measured have a fresh process that is none of one render.
    with_fresh = any("peak_bytes" in row and row["peer"].startswith("rt ") for row in entry["rows"])
    head = (["", "time", "times rt's", "first render", "load"] + ["fresh process", "memory"] * with_fresh
            + ["MSE", "MSE x time, times rt's"] * with_error)
    rows, skipped = [], []
    for row in entry["rows"]:
        if "skipped" in row:
            skipped.append(f"{row['peer']} ({row['skipped']})")
            continue
        number = lambda key, form: format(row[key], form) if key in row else ""
        cells = [row["peer"], time_text(row["seconds"]), number("ratio", ".2f"), time_text(row.get("first_seconds")),
                 time_text(row.get("load_seconds"))]
        if with_fresh:
            cells += [time_text(row.get("command_seconds")),
                      f"{row['peak_bytes'] / 1e6:.0f} MB" if "peak_bytes" in row else ""]
        if with_error:
            cells += [number("mse", ".2e"), number("error_time_ratio", ".2f")]
        rows.append(cells)
    lines += table(head, rows)
    if skipped:
        lines += ["", "Not measured: " + "; ".join(skipped) + "."]
    return lines + [""]


def sweep_text(results, of):
    sweeps = [sweep for sweep in results["sweeps"] if sweep["of"] == of]
    if not sweeps:
        return []
    lines = [f"### {of.capitalize()}", "", f"![time against {SWEEPS[of]}](images/scaling-{of}.svg)", "",
             "| device | scene | from | to | exponent | upper half | date | |", "|---|---|---|---|---|---|---|---|"]
    for sweep in sweeps:
        points = sweep["points"]
        first, last = points[0], points[-1]
        scene = "cloud-N" if of == "spheres" else f"{first['scene']}"
        number = lambda key: f"{sweep[key]:.2f}" if sweep[key] is not None else ""
        ends = [f"{count_text(point['x'])}: {time_text(point['render_seconds']['min'])}" for point in (first, last)]
        lines.append(f"| {device_text(sweep)} | {scene}, {last['width']}x{last['height']}, "
                     f"{last['samples']} a pixel | {ends[0]} | {ends[1]} | {number('exponent')} | "
                     f"{number('upper_exponent')} | {sweep['date'][:10]} | {sweep['left_out']} |")
    return lines + [""]


def bench_text(entry):
    phases, first = entry["phases"], entry["first"]
    lines = [f"### {entry['scene']} on {device_text(entry)}", "",
             f"{entry['width']}x{entry['height']}, {entry['samples']} samples a pixel, {entry['spheres']} spheres, "
             f"{entry['precision']}; "
             f"driver {entry['device']['driver']}; {entry['date'][:10]}, rt {entry['version']} {entry['revision']}, "
             f"{entry['repeats']} repeats.", "", "| part | first | min | median | max |", "|---|---|---|---|---|"]
    names = {"bvh": "build tree", "build": "build kernel", "read_back": "read back", "rest": "rest of the session",
             "encode": "encode PNG", "total": "render and encode"}
    lines += [f"| load scene | {time_text(entry['load_seconds'])} | | | |",
              f"| pack scene | {time_text(entry['pack_seconds'])} | | | |"]
    for phase, spread in phases.items():
        lines.append(f"| {names.get(phase, phase)} | {time_text(first[phase])} | "
                     + " | ".join(time_text(spread[key]) for key in ("min", "median", "max")) + " |")
    for key, name in (("samples_per_second", "samples/s"), ("segments_per_second", "rays/s")):
        lines.append(f"| {name} | | " + " | ".join(count_text(entry[key][end]) for end in ("min", "median", "max"))
                     + " |")
    peak, model = entry["peak"], entry["model"]
    kernels = "; ".join(
        f"{kernel['entry']}: {kernel['registers']} registers, occupancy {100 * kernel['occupancy']:.0f} %"
        for kernel in entry["build"]["kernels"] if kernel.get("registers") and kernel.get("occupancy"))
    share = f"; sphere tests {100 * model['share_of_fma_peak']:.1f} % of the former" if model else ""
    lanes = f"{entry['lanes']} lane{'s' if entry['lanes'] > 1 else ''}"
    lines += ["", f"{entry['launches']} launches, {lanes}{', a tree' if entry['bvh'] else ''}. Peak "
              f"{count_text(peak['fma_per_second'])} fma/s, {count_text(peak['integer_per_second'])} integer "
              f"multiply-adds/s{share}. {kernels}".rstrip(), ""]
    return lines


def table(head, rows):
    return ["| " + " | ".join(head) + " |", "|" + "---|" * len(head), *("| " + " | ".join(row) + " |" for row in rows)]


def rungs_text(results):
    rows = [(f"{short_name(entry['device'])} ({entry['backend']})",
             f"{entry['scene']}, {entry['size']}, {entry['samples']} a pixel", time_text(entry["seconds"]),
             *(f"{entry['of_exact'][rung]:.2f}" if rung in entry["of_exact"] else "" for rung in ("fast", "double")),
             entry["date"]) for entry in results["rungs"]]
    return ["## Rungs", "",
            "The rungs in turn, again and again (`build/tools/rt_measure_rungs`): the median ratio of times, of the exact",
            "rung's. On a processor it is time on all cores that counts; on a GPU renders of a millisecond or two,",
            "in which reading back counts too.", "",
            *table(("device", "scene", "exact", "fast", "double", "date"), rows), ""]


def crossovers_text(results):
    lines = ["## Trees", "",
             "From how many spheres on is a tree faster (`tools/bench_crossover`, clouds with and without one in turn)?",
             "The ratio of times without and with a tree: above 1 the tree is faster. render/session.cpp holds the numbers",
             "that rt goes by. A GPU goes by those of one lane; its renders of few spheres take 40 to 60 microseconds, so",
             "their ratios are rough.", ""]
    for entry in results["crossovers"]:
        for lanes in entry["crossover"]:
            points = lanes["points"]
            name = f"{short_name(entry['device']['name'])} ({entry['device']['backend']}), {lanes['lanes']} lane"
            lines += [f"{name}{'s' if lanes['lanes'] > 1 else ''}, {entry['date'][:10]}:", "",
                      *table(["spheres"] + [str(point["spheres"]) for point in points],
                             [["ratio"] + [f"{point['ratio']:.2f}" for point in points]]), ""]
    return lines


def starts_text(results):
    rows = [(f"`{entry['case']}`", f"{short_name(entry['device']['name'])} ({entry['device']['backend']})",
             *(time_text(entry[which][least]) for which in ("cold", "warm") for least in ("min", "median")),
             f"{entry['processors']} processors, load {entry['load']:.2g}, {entry['date'][:10]}")
            for entry in results["starts"]]
    return ["## From the command line to the picture", "",
            "A process of its own opens the device, tests it, compiles, renders and writes a PNG (`tools/bench_start`).",
            "*Cold*: with empty caches of rt and of the driver; *warm*: the command again.", "",
            *table(("case", "device", "cold, least", "median", "warm, least", "median", "on"), rows), ""]


def profile_text(entry):
    rows = [(told, f"{entry['metrics'][name]:,.4g}".replace(",", " ") + unit if entry["metrics"][name] < 1e5
             else count_text(entry["metrics"][name])) for name, told, unit in METRICS if name in entry["metrics"]]
    lines = [f"### A launch under Nsight Compute, {entry['device']}, {entry['date']}", "", f"{entry['what']}", "",
             *table(("", ""), rows), ""]
    if "parts" in entry:
        # Entered by hand from `ncu --page source`: which instructions are which part of the kernel nobody else knows.
        parts = entry["parts"]
        total = sum(part["instructions"] for part in parts)
        needed = sum(part["instructions"] * part["lanes"] for part in parts) / 32
        best = entry["metrics"]["Duration"] * needed / total * entry["metrics"]["Issue Slots Busy"] / 100
        lines += ["By part, warp instructions a segment of 32 lanes, and how many of these are active:", "",
                  *table(("part", "instructions", "active lanes"),
                         [(part["part"], f"{part['instructions']:.0f}", f"{part['lanes']:.1f}") for part in parts]), "",
                  f"With all lanes active they would be {needed:.0f} instead of {total:.0f}, and with every issue slot used, too, the",
                  f"launch would take {best:.2g} ms: nearer than that only other arithmetic gets.", ""]
    return lines


def steps_text(results):
    return ["## Steps", "", "What was changed, or tried, and what it gave.", "",
            *table(("what", "before", "after", "on", "date"),
                   [tuple(step[key] for key in ("what", "before", "after", "where", "date"))
                    for step in results["steps"]]), ""]


def page(results):
    lines = ["# Performance", "",
             "<!-- Made by tools/plot_performance.py from docs/performance.json; do not edit. -->", "",
             "How fast rt is, against other path tracers on the same scenes, and how time grows with what a render is",
             "made of. Figures are of the devices and days that they name; shared machines are noisy, so only ratios",
             "of one run count, and a load average above the number of processors says that even these are rough.",
             "Speed is not promised (README.md); bits are, and nothing here can change one.",
             "", "## Measuring", "",
             "    rt bench weekend --size 1200x675 --spp 100 --json weekend.json",
             "    rt bench --sweep spheres --size 400x225 --spp 16 --json spheres.json",
             "    tools/bench_peers --mitsuba PYTHON --cycles PYTHON --book DIR --error 16 --json cpu.json",
             "    tools/bench_peers --set gpu --backends cuda,opencl --mitsuba PYTHON --seed DIR --rogerallen DIR "
             "--json gpu.json",
             "    tools/bench_crossover --backend opencl --lanes 1,8 --json crossover.json",
             "    tools/bench_start --json start.json",
             "    tools/measure_mean --json mean.json",
             "    build/tools/rt_measure_rungs weekend --backend opencl --size 240x135 > rungs.txt",
             "    tools/plot_performance.py --add weekend.json spheres.json cpu.json gpu.json crossover.json start.json "
             "mean.json rungs.txt", "",
             "The last command puts results into docs/performance.json and makes this page and its plots anew.",
             "`tools/count_instructions` is the part that CI runs: instructions of small renders, which do not depend",
             "on what else a machine does.", "", "## Targets", "",
             "Where several processors were measured, the worst counts.", "", *verdicts(results), "",
             *parts_of_render(results)]
    if results["peers"]:
        lines += ["## Peers", "",
                  "Times are the least of some repeats, from a loaded scene to the film on the host. *First render*",
                  "has compilation in it. *Fresh process* and *memory* are the least time and the most memory of",
                  "three commands that start, load, render once and write the film as floats (runs before 07:00 UTC of",
                  "2026-11-23 looked at them every 50 ms: times up to that much too long); Blender's start is in",
                  "Cycles'. *MSE* is against the same program's own image of many more samples and another seed.",
                  "",
                  "rt's base row has independent random numbers, as Mitsuba has; Cycles has Sobol points. rt's base",
                  "and the book have no Russian roulette; *roulette* marks rows with it, in rt from the scattering",
                  "from which Mitsuba plays. Targets hold where the worse of two ratios does: without roulette in both,",
                  "and with it in both where rt was measured so (else the peer's with it against rt without).",
                  "Mitsuba and Cycles have no fuzzy metal, and are given rough conductors",
                  "with half the fuzz as slope, unless it is said otherwise. In Cycles spheres are point clouds, but",
                  "glass ones are fine meshes, since a path in a point never leaves it; its sky is met by chance, as",
                  "in rt: rays aimed at it doubled the time and lowered the error by nothing or a few percent. The book's",
                  "second volume has a sky of one colour.", ""]
        for entry in results["peers"]:
            lines += peers_text(entry)
    if results["starts"]:
        lines += starts_text(results)
    if results["sweeps"]:
        lines += ["## Scaling", "",
                  "Least of the repeats, launches and reading back; exponents of time by least squares on logarithms,",
                  "over all points and over the upper half of them. A thread that other work keeps from its processor",
                  "speeds up nothing: the sweep of threads needs a machine of its own, which this one was not.", ""]
        for of in SWEEPS:
            lines += sweep_text(results, of)
    if results["benches"]:
        lines += ["## Part by part", "",
                  "The share of the peak counts 17 operations (9 of them fma) for each test of a ray against a sphere,",
                  "and nothing for all the rest: it is a lower bound, and the same for every program.", ""]
        for entry in results["benches"]:
            lines += bench_text(entry)
    for entry in results["profiles"]:
        lines += profile_text(entry)
    if results["crossovers"]:
        lines += crossovers_text(results)
    if results["rungs"]:
        lines += rungs_text(results)
    for entry in results["means"]:
        lines += ["## Accuracy at many spheres", "",
                  f"{entry['scene']}, {entry['size']}, {entry['samples']} samples a pixel on the {entry['backend']} "
                  f"backend, {entry['date'][:10]} (`tools/measure_mean`): mean {entry['mean']:.6f} in the double rung;",
                  f"exact differs by {entry['relative_difference']:+.1e} of it, standard error "
                  f"{entry['standard_error']:.1e}.", ""]
    if results["steps"]:
        lines += steps_text(results)
    while lines[-1] == "":
        lines.pop()
    return "\n".join(lines) + "\n"


def plot(results):
    pyplot = pyplot_of_house()
    for of, label in SWEEPS.items():
        path = IMAGES / f"scaling-{of}.svg"
        sweeps = [sweep for sweep in results["sweeps"] if sweep["of"] == of]
        if not sweeps:
            path.unlink(missing_ok=True)
            continue
        figure, axes = pyplot.subplots(figsize=(5, 3.2), layout="constrained")
        for sweep, marker in zip(sweeps, "osD^v<>*" * 4):
            xs = [point["x"] for point in sweep["points"]]
            ys = [point["render_seconds"]["min"] for point in sweep["points"]]
            exponent = f", exponent {sweep['upper_exponent']:.2f}" if sweep["upper_exponent"] is not None else ""
            axes.loglog(xs, ys, marker=marker, markersize=4, linewidth=1, label=device_text(sweep) + exponent)
        axes.set_xlabel(label)
        axes.set_ylabel("seconds")
        axes.grid(True, which="major", linewidth=0.3)
        axes.legend(fontsize=7, frameon=False)
        save(pyplot, figure, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--add", nargs="+", default=[], metavar="FILE", help="results to take up")
    parser.add_argument("--date", default=datetime.date.today().isoformat(), help="of text that has none (today)")
    parser.add_argument("--profile", nargs=4, metavar=("FILE", "DATE", "DEVICE", "WHAT"), help="a profile to take up")
    parser.add_argument("--check", action="store_true", help="only compare the page with the results")
    options = parser.parse_args()
    results = load("performance", KINDS)
    if options.check:
        check("performance", page(results))
        return
    for path in options.add:
        text = Path(path).read_text()
        if text.lstrip().startswith("{"):
            add(results, json.loads(text), path)
        else:
            add_rungs(results, text, path, options.date)
    if options.profile:
        add_profile(results, *options.profile)
    keep("performance", results, page(results))
    plot(results)


main()
