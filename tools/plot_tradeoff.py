#!/usr/bin/env python3
"""Draws error against time from the results of `rt tradeoff --json`, and makes docs/tradeoff.md from docs/tradeoff.json.

    tools/plot_tradeoff.py RESULT.json -o PLOT.svg    one scene: a line a configuration, and the front
    tools/plot_tradeoff.py --add FILE...    takes up results of `rt tradeoff --json`, of `rt_measure_rungs --json` and
                                            of `rt_measure_features --json`, in the place of older ones of the same
                                            scene and device; then makes page and plots
    tools/plot_tradeoff.py                  makes page and plots
    tools/plot_tradeoff.py --check          is the page what the results say? (without plots, so no matplotlib)

Needs matplotlib for the plots.
"""

import argparse
import json
import math
import sys
from pathlib import Path

from results_page import IMAGES, check, keep, load, picked, pyplot_of_house, replace, save


# ---- results --------------------------------------------------------------------------------------------------------


def configuration(point):
    """As rt tradeoff names it: the precision, then what is not as plain as can be."""
    words = [point["precision"]]
    if point["sampler"] != "independent":
        words.append(point["sampler"])
    if point["estimator"] != "path":
        words.append(point["estimator"])
    if point["roulette"]:
        words.append(f"roulette {point['roulette']}")
    return " ".join(words)


def curves(result):
    """Points by device and configuration, in the order of samples."""
    groups = {}
    for point in result["points"]:
        groups.setdefault((point["device"], configuration(point)), []).append(point)
    for points in groups.values():
        points.sort(key=lambda point: point["samples"])
    return groups


def device_text(device):
    return f"{device['name']} ({device['backend']})"


# ---- plots ----------------------------------------------------------------------------------------------------------


def plot(result, path):
    pyplot = pyplot_of_house()
    figure, axes = pyplot.subplots(figsize=(7.2, 4.2), layout="constrained")
    front = sorted((point["seconds"], point["rel_rmse"]) for point in result["points"] if point["on_front"])
    if front:
        axes.loglog(*zip(*front), drawstyle="steps-post", color="0.8", linewidth=5, zorder=0, label="front")
    for (device, name), points in curves(result).items():
        label = name if len(result["devices"]) == 1 else f"{result['devices'][device]['backend']}: {name}"
        index = len(axes.lines) - 1
        line, = axes.loglog([point["seconds"] for point in points], [point["rel_rmse"] for point in points],
                            marker="osD^v<>*"[index % 8], markersize=4, linewidth=1, label=label)
        # What is only a bound is drawn hollow.
        bounds = [point for point in points if point["is_bound"]]
        axes.loglog([point["seconds"] for point in bounds], [point["rel_rmse"] for point in bounds], linestyle="",
                    marker=line.get_marker(), markersize=4, color=line.get_color(), markerfacecolor="white",
                    label="_bounds")
    axes.set_xlabel(f"seconds, {result['width']}x{result['height']}")
    axes.set_ylabel("error (relative RMSE)")
    axes.set_title(f"{result['scene']}, {device_text(result['devices'][0])}" if len(result["devices"]) == 1
                   else result["scene"], fontsize=9)
    axes.grid(True, which="major", linewidth=0.3)
    axes.legend(loc="center left", bbox_to_anchor=(1.01, 0.5), fontsize=7, frameon=False)
    save(pyplot, figure, path)


# ---- results, kept --------------------------------------------------------------------------------------------------

# A z-score that chance does not give; a render too short for its time to say much.
CLEAR_Z = 4
SHORT_SECONDS = 0.005
# Of each measurement only what the page needs, so that the file stays small.
DEVICE_KEYS = ("backend", "name", "driver", "compute_units")
POINT_KEYS = ("device", "precision", "sampler", "estimator", "roulette", "samples", "seconds", "most_seconds", "repeats",
              "rmse", "rel_mse", "rel_rmse", "is_bound", "rel_mse_trimmed", "flip", "bias", "on_front", "film_hash")
FACTS = ("version", "revision", "contract", "date", "threads", "note")


def add(results, document, path):
    """Puts a result in, in the place of an older one of its scene and device."""
    facts = picked(document, FACTS)
    if "points" in document:
        entry = {**facts, **picked(document, ("scene", "width", "height", "image", "seconds", "complete", "left_out",
                                              "reference", "advice")),
                 "devices": [picked(device, DEVICE_KEYS) for device in document["devices"]],
                 "points": [picked(point, POINT_KEYS) for point in document["points"]]}
        replace(results["tradeoffs"], entry, lambda other: (other["scene"], [(device["backend"], device["name"])
                                                                           for device in other["devices"]]))
    elif "rung_scenes" in document:
        for scene in document["rung_scenes"]:
            entry = {**facts, **picked(document, ("width", "height", "samples", "rounds", "ulp_bins")),
                     "device": picked(document["device"], DEVICE_KEYS), **scene}
            replace(results["rungs"], entry, lambda other: (other["device"]["name"], other["device"]["backend"],
                                                            other["scene"]))
    elif "feature_scenes" in document:
        for scene in document["feature_scenes"]:
            entry = {**facts, **picked(document, ("width", "height", "samples", "rounds", "nvrtc", "capability")),
                     "device": picked(document["device"], DEVICE_KEYS), **scene}
            replace(results["features"], entry, lambda other: (other["device"]["name"], other["device"]["backend"],
                                                               other["scene"]))
    else:
        sys.exit(f"plot_tradeoff: {path} is no result of rt tradeoff, rt_measure_rungs or rt_measure_features")


# ---- the page -------------------------------------------------------------------------------------------------------


def time_text(seconds):
    if seconds < 0.0995:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.3g} s"


def percent_text(share):
    return f"{100 * share:.3g} %"


def bytes_text(count):
    return f"{count / 1024:.1f} KiB" if count else ""


def count_text(value):
    for size, letter in ((1e12, " T"), (1e9, " G"), (1e6, " M"), (1e3, " k")):
        if value >= size:
            return f"{value / size:.3g}{letter}"
    return f"{value:.0f}"


def measured_text(entry):
    note = f"; {entry['note']}" if entry.get("note") else ""
    return f"{entry['date'][:10]}, rt {entry.get('version', '')} {entry.get('revision', '')}".rstrip() + note


def clearest(bias):
    return max(bias.values(), key=lambda channel: abs(channel["z"]))


def samples_for(points, error):
    """How many samples a configuration needs, between those that were measured; None beyond them."""
    for before, after in zip(points, points[1:]):
        if after["rel_rmse"] <= error <= before["rel_rmse"] and not after["is_bound"]:
            part = math.log(before["rel_rmse"] / error) / math.log(before["rel_rmse"] / after["rel_rmse"])
            samples = before["samples"] * (after["samples"] / before["samples"]) ** part
            seconds = before["seconds"] * (after["seconds"] / before["seconds"]) ** part
            return samples, seconds
    return None


def anchor(text):
    return "".join(letter if letter.isalnum() else "-" for letter in text.lower())


def plot_name(result):
    devices = "-".join(anchor(f"{device['backend']}-{device['name']}") for device in result["devices"])
    return f"tradeoff-{anchor(result['scene'])}-{devices}.svg"


def identity_rows(results):
    """Time of exact over fast at the most samples that both were measured with."""
    rows = []
    for result in results["tradeoffs"]:
        groups = curves(result)
        for device, facts in enumerate(result["devices"]):
            exact = {point["samples"]: point for point in groups.get((device, "exact"), [])}
            fast = {point["samples"]: point for point in groups.get((device, "fast"), [])}
            double = {point["samples"]: point for point in groups.get((device, "double"), [])}
            both = sorted(set(exact) & set(fast))
            if not both:
                continue
            most = both[-1]
            ratio = exact[most]["seconds"] / fast[most]["seconds"]
            twice = sorted(set(exact) & set(double))
            of_double = (f"{double[twice[-1]]['seconds'] / exact[twice[-1]]['seconds']:.2f}" if twice else "")
            worse = exact[most]["rel_rmse"] / fast[most]["rel_rmse"] - 1
            rows.append(f"| {result['scene']} | {device_text(facts)} | {most} | {time_text(exact[most]['seconds'])} | "
                        f"{ratio:.2f} | {of_double} | {100 * worse:+.2g} % |")
    return rows


def rung_rows(entry):
    rows = []
    for rung in entry["rungs"]:
        if rung["rung"] == entry["against"]:
            continue
        channel = max(range(3), key=lambda c: abs(rung["z"][c]))
        same = rung["ulp_percent"][0]
        far = sum(rung["ulp_percent"][4:])
        noise = f"{percent_text(rung['rel_rmse'])} | {rung['flip']:.4f}" if "rel_rmse" in rung else " | "
        name = rung["rung"] if not rung["is_part"] else "&nbsp;&nbsp;" + rung["rung"]
        rows.append(f"| {name} | {rung['of_exact']:.2f} | {same:.1f} % | {far:.2f} % | {rung['rmse']:.1e} | "
                    f"{rung['bias'][channel]:+.1e} ({rung['z'][channel]:+.1f}) | {noise} |")
    return rows


def bias_lines(results):
    """Which parts of fast have a bias that is no chance."""
    found, scenes = {}, 0
    for entry in results["rungs"]:
        scenes += 1
        for rung in entry["rungs"]:
            channel = max(range(3), key=lambda c: abs(rung["z"][c]))
            if rung["rung"] not in ("exact", "double") and abs(rung["z"][channel]) >= CLEAR_Z:
                found.setdefault(rung["rung"], []).append((abs(rung["bias"][channel]), rung["z"][channel], entry))
    if not found:
        return [f"No bias was found in {scenes} measurements (all |z| below {CLEAR_Z}).", ""]
    lines = [f"Biases that are no chance (|z| of {CLEAR_Z} or more) in {scenes} measurements:", ""]
    for name, cases in found.items():
        size, z, entry = max(cases, key=lambda case: case[0])
        lines.append(f"- {name}: in {len(cases)}, at most {size:.1e} of the mean radiance (z {z:+.1f}, {entry['scene']} on "
                     f"{device_text(entry['device'])}).")
    return lines + [""]


def short_text(entry):
    exact = next(rung for rung in entry["rungs"] if rung["rung"] == "exact")
    if exact["seconds"] >= SHORT_SECONDS:
        return []
    return [f"Renders of {time_text(exact['seconds'])}, which is mostly starting them: times say little here.", ""]


def float_rows(results):
    """From how many samples on the difference between float and double is larger than the noise."""
    rows = []
    for entry in results["rungs"]:
        rungs = {rung["rung"]: rung for rung in entry["rungs"]}
        if entry["against"] != "exact" or "double" not in rungs or "rmse_to_double" not in rungs["exact"]:
            continue
        apart, noise = rungs["double"]["rmse"], rungs["exact"]["rmse_to_double"]
        channel = max(range(3), key=lambda c: abs(rungs["double"]["z"][c]))
        bias = rungs["double"]["bias"][channel]
        needed = entry["samples"] * (noise / apart) ** 2 if apart > 0 else math.inf
        rows.append((needed, f"| {entry['scene']} | {device_text(entry['device'])} | {noise:.1e} | {apart:.1e} | "
                     f"{noise / apart if apart else math.inf:.0f} | {-bias:+.1e} "
                     f"({-rungs['double']['z'][channel]:+.1f}) | {rungs['double']['of_exact']:.2f} |"))
    return [row for _, row in sorted(rows)]


def gain_rows(results):
    """MSE x time against plain exact sampling, at the same number of samples."""
    rows = []
    for result in results["tradeoffs"]:
        groups = curves(result)
        for (device, name), points in groups.items():
            plain = {point["samples"]: point for point in groups.get((device, "exact"), [])}
            if name in ("exact", "fast", "double"):
                continue
            cells = []
            for point in points:
                other = plain.get(point["samples"])
                if other and not point["is_bound"] and not other["is_bound"]:
                    cells.append((point["samples"], other["rel_mse"] / point["rel_mse"],
                                  point["seconds"] / other["seconds"]))
            if cells:
                samples, error, seconds = cells[-1]
                rows.append(f"| {result['scene']} | {device_text(result['devices'][device])} | {name} | {samples} | "
                            f"{error:.2f} | {seconds:.2f} | {error / seconds:.2f} |")
    return rows


def tradeoff_text(result):
    lines = [f"### {result['scene']} on {device_text(result['devices'][0])}", "",
             f"![error against time](images/{plot_name(result)})", "",
             f"{result['width']}x{result['height']}; {measured_text(result)}. Reference: "
             f"{result['reference']['samples']} samples, {result['reference']['precision']}, known to "
             f"{percent_text(result['reference']['rel_rmse'])}.", "",
             "| | configuration | samples | time | worst | error | FLIP | bias (z) |",
             "|---|---|---|---|---|---|---|---|"]
    for point in sorted(result["points"], key=lambda point: point["seconds"]):
        bias = clearest(point["bias"])
        lines.append(f"| {'*' if point['on_front'] else ''} | {configuration(point)} | {point['samples']} | "
                     f"{time_text(point['seconds'])} | {time_text(point['most_seconds'])} | "
                     f"{'<' if point['is_bound'] else ''}{percent_text(point['rel_rmse'])} | {point['flip']:.4f} | "
                     f"{100 * bias['relative']:+.2g} % ({bias['z']:+.1f}) |")
    lines += ["", *(f"Left out: {what}.  " for what in result["left_out"])]
    way = (result.get("advice") or {}).get("recommended")
    if way:
        lines += ["", f"Recommended for the error of the scene's own settings: `{way['command']}`."]
    return lines + [""]


def accuracy_rows(results):
    rows = []
    for result in results["tradeoffs"]:
        for (device, name), points in curves(result).items():
            if name in ("fast", "double"):
                continue
            cells = []
            for error in (0.2, 0.1, 0.05, 0.02):
                found = samples_for(points, error)
                cells.append(f"{found[0]:.0f} ({time_text(found[1])})" if found else "not reached")
            rows.append(f"| {result['scene']} | {device_text(result['devices'][device])} | {name} | "
                        + " | ".join(cells) + " |")
    return rows


def feature_text(entry):
    lines = [f"### {entry['scene']} on {device_text(entry['device'])}", "",
             f"{entry['width']}x{entry['height']}, {entry['samples']} samples, {entry['rounds']} rounds; "
             f"{measured_text(entry)}. The scene's own: {', '.join(entry['features'])}.", "",
             "| program with | time, times its own | of the rounds | build | code |"
             + (f" sm_{entry['capability']} registers | its code | its build |" if entry.get("nvrtc") else ""),
             "|---|---|---|---|---|" + ("---|---|---|" if entry.get("nvrtc") else "")]
    for program in entry["programs"]:
        line = (f"| {program['features']} | {program['ratio']:.3f} | {program['least_ratio']:.2f} to "
                f"{program['most_ratio']:.2f} | {time_text(program['build_seconds'])} | "
                f"{bytes_text(program['code_bytes'])} |")
        if use := program.get("ptxas"):
            line += f" {use['registers']} | {bytes_text(use['code_bytes'])} | {time_text(use['seconds'])} |"
        lines.append(line)
    return lines + [""]


def page(results):
    lines = ["# Speed against accuracy", "",
             "<!-- Made by tools/plot_tradeoff.py from docs/tradeoff.json; do not edit. -->", "",
             "For someone who must choose: a precision, a sampler, an estimator, a number of samples. All figures are",
             "measured, on the devices and days that they name. The processors' figures are of a machine with two cores",
             "that other programs shared: times are the least of some repeats, and only ratios of one run count.",
             "*Error* is the relative RMSE against a converged image in double of other random numbers, whose own error",
             "is taken off; 2 % is an image that looks clean, 10 % one that looks grainy.", "",
             "The short answer for your scene and your device is", "",
             "    rt tradeoff SCENE --target-error 0.02",
             "    rt render SCENE --auto-precision --target-error 0.02", "",
             "## Measuring", "",
             "    rt tradeoff three-spheres --json three-spheres.json",
             "    build/tools/rt_measure_rungs features three-spheres --json rungs.json",
             "    build/tools/rt_measure_features three-spheres --json features.json",
             "    tools/plot_tradeoff.py --add three-spheres.json rungs.json features.json", "",
             "The last command puts results into docs/tradeoff.json and makes this page and its plots anew.", ""]
    if rows := identity_rows(results):
        lines += ["## What does identity cost, and how much faster is fast?", "",
                  "Time of `exact` (the same bits on every device) over `fast` (what the device does best), and of",
                  "`double` over `exact`, at the most samples that both were measured with. Above 1, identity costs;",
                  "below, fast is the slower one: what a device calls fast is not always. *Error*: of exact over fast.",
                  "", "| scene | device | samples | exact | exact / fast | double / exact | error |",
                  "|---|---|---|---|---|---|---|", *rows, ""]
    if results["rungs"]:
        lines += ["## How wrong is fast?", "",
                  "The rungs take the same random numbers, so images are held against `exact` pixel by pixel. *Same*: values",
                  "of the same bits; *far*: 16 float steps apart or more, which is a path that went another way. *Bias*:",
                  "signed mean difference of the channel where it is clearest, over the mean radiance, with its z-score;",
                  "|z| above 4 is a bias and no chance. *Error* and *FLIP* are against the converged image, noise and all:",
                  "where they are as exact's, no eye will see the difference. The indented rows are of fast with one of its",
                  "approximations alone, and tell which operation a bias comes from.", "", *bias_lines(results)]
        for entry in results["rungs"]:
            lines += [f"### {entry['scene']} on {device_text(entry['device'])}", "",
                      f"{entry['width']}x{entry['height']}, {entry['samples']} samples; {measured_text(entry)}.", "",
                      "| rung | time, times exact's | same | far | RMSE to exact | bias (z) | error | FLIP |",
                      "|---|---|---|---|---|---|---|---|", *rung_rows(entry), "", *short_text(entry)]
    if rows := float_rows(results):
        lines += ["## Where does float end and double begin?", "",
                  "Not where one might think: the noise of an image is larger than float's rounding until a great many",
                  "samples. *Noise* and *apart* are RMSEs: of exact against the truth with these samples, and of exact",
                  "against double with the same random numbers; most of the latter is paths that a last bit sends another",
                  "way, which is noise as well and falls with the samples as noise does. What remains of float in the end",
                  "is its bias. One below 6e-8 is of the size of a float's step: the scene's own numbers are rounded too",
                  "(0.8 is 1.5e-8 too large as a float), which all samples share, so that it is certain (a large |z|) and",
                  "of no matter. Scenes where double is worth its time come first.", "",
                  "| scene | device | noise | apart | noise / apart | float's bias (z) | double, times exact's time |",
                  "|---|---|---|---|---|---|---|", *rows, ""]
    if rows := accuracy_rows(results):
        lines += ["## How many samples does a bit of accuracy cost?", "",
                  "Half the error costs four times the samples, by chance alone; samplers that do better are measured",
                  "below. Samples (and time at the size measured) for an error, between measured numbers of samples:", "",
                  "| scene | device | configuration | 20 % | 10 % | 5 % | 2 % |", "|---|---|---|---|---|---|---|", *rows,
                  ""]
    lines += ["## What do samplers and estimators gain?", ""]
    if rows := gain_rows(results):
        lines += ["MSE and time against plain `exact` at the same number of samples; the gain is the one over the other.",
                  "", "| scene | device | configuration | samples | MSE, times less | time, times | gain |",
                  "|---|---|---|---|---|---|---|", *rows, ""]
    else:
        lines += ["Not measured yet.", ""]
    if not any(device["backend"] == "cuda" for result in results["tradeoffs"] for device in result["devices"]):
        lines += ["No GPU was measured with them yet.", ""]
    if results["features"]:
        lines += ["## What does a feature cost a scene that does not use it?", "",
                  "Nothing: a scene's program is compiled for its features, and the text that the compiler sees is the",
                  "same as if the others had never been written (`tests/test_feature_text.cpp`). What specialising is worth,",
                  "and what a feature would cost if it were left in; times in turns, ratios of each round, their median.",
                  "A feature moves a program's registers and time either way: compilers order the same code otherwise.",
                  ""]
        for entry in results["features"]:
            lines += feature_text(entry)
    if results["tradeoffs"]:
        lines += ["## All that was measured", "",
                  "`*`: nothing else is as quick and as near to the reference. `<`: no more can be told than that the error",
                  "is below. Bias is against a reference of other random numbers: chance gives |z| up to 3.", ""]
        for result in results["tradeoffs"]:
            lines += tradeoff_text(result)
    while lines[-1] == "":
        lines.pop()
    return "\n".join(lines) + "\n"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("result", nargs="?", help="a result of rt tradeoff --json, to be drawn into --output")
    parser.add_argument("-o", "--output", help="the plot: .svg, .png or .pdf")
    parser.add_argument("--add", nargs="+", default=[], metavar="FILE", help="results to take up")
    parser.add_argument("--check", action="store_true", help="only compare the page with the results")
    options = parser.parse_args()
    if bool(options.result) != bool(options.output):
        parser.error("a result and --output go together")
    if options.result:
        plot(json.loads(Path(options.result).read_text()), options.output)
        return
    results = load("tradeoff", ("tradeoffs", "rungs", "features"))
    if options.check:
        check("tradeoff", page(results))
        return
    for path in options.add:
        add(results, json.loads(Path(path).read_text()), path)
    keep("tradeoff", results, page(results))
    for result in results["tradeoffs"]:
        plot(result, IMAGES / plot_name(result))


main()
