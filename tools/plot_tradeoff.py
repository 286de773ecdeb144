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


def undisturbed(result):
    """The result with times that the rest of the machine has no part in: where the cores' seconds are known, these over
    the number of cores, and the front by them."""
    points = []
    for point in result["points"]:
        cores, units = point.get("cpu_seconds"), result["devices"][point["device"]].get("compute_units")
        points.append({**point, "seconds": cores / units, "most_seconds": None} if cores and units else dict(point))
    if any(point["most_seconds"] is None for point in points):
        best = math.inf
        for point in sorted(points, key=lambda point: (point["seconds"], point["rel_rmse"])):
            point["on_front"] = point["rel_rmse"] < best * (1 - CLEARLY_NEARER)
            best = min(best, point["rel_rmse"]) if point["on_front"] else best
    return {**result, "points": points}


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

# A z-score that chance does not give; a render too short for its time to say much; half a float's last bit at 1; what a
# feature may cost a scene that does not use it.
CLEAR_Z = 4
SHORT_SECONDS = 0.005
CLEARLY_NEARER = 0.01 # as render/tradeoff.h has it
FLOAT_STEP = 2 ** -24
FEATURE_LIMIT = 0.02
# With fewer samples chance decides whether an image has met its rare bright paths, and gains of a thousand appear.
TRUSTED_SAMPLES = 64
# Of each measurement only what the page needs, so that the file stays small.
DEVICE_KEYS = ("backend", "name", "driver", "compute_units")
POINT_KEYS = ("device", "precision", "sampler", "estimator", "roulette", "samples", "seconds", "most_seconds", "repeats",
              "cpu_seconds", "rmse", "rel_mse", "rel_rmse", "is_bound", "rel_mse_trimmed", "flip", "bias", "on_front",
              "film_hash")
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
    """How many samples a configuration needs for an error, their time, and whether that lies beyond what was measured:
    there the error falls with the root of the samples, as for rt tradeoff. None below what one sample gives."""
    known = [point for point in points if not point["is_bound"]]
    if known and known[-1]["rel_rmse"] > error:
        times = (known[-1]["rel_rmse"] / error) ** 2
        return known[-1]["samples"] * times, known[-1]["seconds"] * times, True
    # From where on it stays below: of rare bright paths, few samples may have met none.
    for before, after in reversed(list(zip(known, known[1:]))):
        if after["rel_rmse"] <= error <= before["rel_rmse"]:
            part = math.log(before["rel_rmse"] / error) / math.log(before["rel_rmse"] / after["rel_rmse"])
            samples = before["samples"] * (after["samples"] / before["samples"]) ** part
            seconds = before["seconds"] * (after["seconds"] / before["seconds"]) ** part
            return samples, seconds, False
    return None


def samples_for_half(points):
    """How many times the samples half the error takes, by the line through the logarithms from 4 samples on."""
    known = [(math.log(point["samples"]), math.log(point["rel_rmse"])) for point in points
             if point["samples"] >= 4 and not point["is_bound"]]
    if len(known) < 3:
        return None
    x, y = (sum(column) / len(known) for column in zip(*known))
    slope = sum((a - x) * (b - y) for a, b in known) / sum((a - x) ** 2 for a, _ in known)
    return 2 ** (-1 / slope) if slope < -0.1 else None


def anchor(text):
    return "".join(letter if letter.isalnum() else "-" for letter in text.lower())


def plot_name(result):
    devices = "-".join(anchor(f"{device['backend']}-{device['name']}") for device in result["devices"])
    return f"tradeoff-{anchor(result['scene'])}-{devices}.svg"


def identity_cases(results):
    """Scene, device, samples, seconds of exact, exact / fast, double / exact (or None), error of exact over fast's,
    less 1 (or None). Of rt tradeoff at the most samples that exact and fast were both measured with; of rt_measure_rungs
    where rt tradeoff has not measured this scene on this device."""
    cases = []
    for result in results["tradeoffs"]:
        groups = curves(result)
        for device, facts in enumerate(result["devices"]):
            exact, fast, double = ({point["samples"]: point for point in groups.get((device, name), [])}
                                   for name in ("exact", "fast", "double"))
            both, twice = sorted(set(exact) & set(fast)), sorted(set(exact) & set(double))
            if both:
                most = both[-1]
                cases.append((result["scene"], device_text(facts), most, exact[most]["seconds"],
                              exact[most]["seconds"] / fast[most]["seconds"],
                              double[twice[-1]]["seconds"] / exact[twice[-1]]["seconds"] if twice else None,
                              exact[most]["rel_rmse"] / fast[most]["rel_rmse"] - 1))
    measured = {case[:2] for case in cases}
    for entry in results["rungs"]:
        rungs = {rung["rung"]: rung for rung in entry["rungs"]}
        if (entry["scene"], device_text(entry["device"])) not in measured and "fast" in rungs:
            cases.append((entry["scene"], device_text(entry["device"]), entry["samples"], rungs["exact"]["seconds"],
                          1 / rungs["fast"]["of_exact"],
                          rungs["double"]["of_exact"] if "double" in rungs else None,
                          rungs["exact"]["rel_rmse"] / rungs["fast"]["rel_rmse"] - 1 if "rel_rmse" in rungs["fast"]
                          else None))
    return sorted(cases, key=lambda case: (case[1], case[0]))


def identity_rows(results):
    return [f"| {scene} | {device} | {samples} | {time_text(seconds)}"
            f"{' (too short)' if seconds < SHORT_SECONDS else ''} | {ratio:.2f} | "
            f"{f'{double:.2f}' if double else ''} | {f'{100 * worse:+.2g} %' if worse is not None else ''} |"
            for scene, device, samples, seconds, ratio, double, worse in identity_cases(results)]


def clearest_channel(rung):
    return max(range(3), key=lambda c: abs(rung["z"][c]))


def changes(rung):
    """Whether the rung has another bit than what it is held against."""
    return rung["ulp_percent"][0] < 100


def rung_rows(entries):
    """Of one device. A part has a row of its own where it is not alone in changing something."""
    rows = []
    for entry in entries:
        exact = next(rung for rung in entry["rungs"] if rung["rung"] == entry["against"])
        parts = [rung for rung in entry["rungs"] if rung["is_part"] and changes(rung)]
        for rung in entry["rungs"]:
            if rung is exact or rung["is_part"] and (rung not in parts or len(parts) < 2):
                continue
            name = rung["rung"] + (f" (all by {parts[0]['rung'].removesuffix(' alone')})"
                                   if rung["rung"] == "fast" and len(parts) == 1 else "")
            channel = clearest_channel(rung)
            bins = " | ".join(f"{share:.1f}" for share in rung["ulp_percent"])
            noise = (f"{percent_text(rung['rel_rmse'])} ({100 * (rung['rel_rmse'] / exact['rel_rmse'] - 1):+.1g} %) | "
                     f"{rung['flip']:.4f} ({rung['flip'] - exact['flip']:+.0e})" if "rel_rmse" in rung else " | ")
            rows.append(f"| {entry['scene']} | {'&nbsp;&nbsp;' if rung['is_part'] else ''}{name} | "
                        f"{rung['of_exact']:.2f} | {bins} | {rung['rmse']:.1e} | "
                        f"{rung['bias'][channel]:+.1e} ({rung['z'][channel]:+.1f}) | {noise} |")
    return rows


def idle_parts(entries):
    """The parts of fast that changed no bit of any of these."""
    names = {}
    for entry in entries:
        for rung in entry["rungs"]:
            if rung["is_part"] and rung["rung"] != "none of them":
                names.setdefault(rung["rung"].removesuffix(" alone"), []).append(changes(rung))
    return [name for name, changed in names.items() if not any(changed)]


def rung_text(device, entries):
    """The table of one device."""
    lines = [f"### {device}", ""]
    for facts in dict.fromkeys(f"{entry['width']}x{entry['height']}, {entry['samples']} samples, {entry['rounds']} "
                               f"rounds; {measured_text(entry)}" for entry in entries):
        lines += [f"{facts}.  "]
    if idle := idle_parts(entries):
        lines += [f"Changed no bit here: {', '.join(idle)}.  "]
    if short := [entry["scene"] for entry in entries
                 if next(rung for rung in entry["rungs"] if rung["rung"] == "exact")["seconds"] < SHORT_SECONDS]:
        lines += [f"Renders of less than {time_text(SHORT_SECONDS)}, whose times say little: {', '.join(short)}.  "]
    bins = entries[0]["ulp_bins"]
    return lines + ["", f"| scene | rung | time, times exact's | {bins[0]} ulp % | {' | '.join(bins[1:])} | RMSE | "
                    "bias (z) | error (over exact's) | FLIP (less exact's) |", "|---" * (len(bins) + 7) + "|",
                    *rung_rows(entries), ""]


def bias_lines(results):
    """Which parts of fast have a bias that is no chance, and how large it is."""
    found = {}
    for entry in results["rungs"]:
        for rung in entry["rungs"]:
            channel = clearest_channel(rung)
            if rung["rung"] not in ("exact", "fast", "double") and abs(rung["z"][channel]) >= CLEAR_Z:
                found.setdefault(rung["rung"], []).append((abs(rung["bias"][channel]), rung["z"][channel], entry))
    if not found:
        return [f"No bias was found in {len(results['rungs'])} measurements (all |z| below {CLEAR_Z}).", ""]
    lines = [f"Biases that are no chance (|z| of {CLEAR_Z} or more) in {len(results['rungs'])} measurements, by "
             "operation:", ""]
    for name, cases in found.items():
        size, z, entry = max(cases, key=lambda case: case[0])
        small = ", a " + f"{FLOAT_STEP / size:.0f}th of a float's step" if size < FLOAT_STEP / 2 else ""
        lines.append(f"- {name}: in {len(cases)}, at most {size:.1e} of the mean radiance{small} (z {z:+.1f}, "
                     f"{entry['scene']} on {device_text(entry['device'])}).")
    return lines + [""]


def float_cases(results):
    """(Samples at which noise has fallen to float's bias, whether that is known or a least, entry, rungs), least first."""
    cases = []
    for entry in results["rungs"]:
        rungs = {rung["rung"]: rung for rung in entry["rungs"]}
        if entry["against"] != "exact" or "double" not in rungs or "rmse_to_double" not in rungs["exact"]:
            continue
        channel = clearest_channel(rungs["double"])
        bias, z = abs(rungs["double"]["bias"][channel]), abs(rungs["double"]["z"][channel])
        is_known = z >= CLEAR_Z
        # Where chance may have made it, no more than two standard errors above it.
        size = bias if is_known or z == 0 else bias * (1 + 2 / z)
        needed = entry["samples"] * (rungs["exact"]["rel_rmse"] / size) ** 2 if size > 0 else math.inf
        cases.append((needed, is_known, entry, rungs))
    return sorted(cases, key=lambda case: case[0])


def power_text(value):
    return f"1e{math.floor(math.log10(value))}" if value < math.inf else "never"


def float_rows(results):
    rows = []
    for needed, is_known, entry, rungs in float_cases(results):
        apart, noise = rungs["double"]["rmse"], rungs["exact"]["rmse_to_double"]
        channel = clearest_channel(rungs["double"])
        rows.append(f"| {entry['scene']} | {device_text(entry['device'])} | {noise:.1e} | {apart:.1e} | "
                    f"{noise / apart if apart else math.inf:.0f} | {-rungs['double']['bias'][channel]:+.1e} "
                    f"({-rungs['double']['z'][channel]:+.1f}) | {'' if is_known else 'beyond '}{power_text(needed)} | "
                    f"{rungs['double']['of_exact']:.2f} |")
    return rows


def gain_cases(results):
    """Scene, device, configuration, samples, MSE of plain exact over its own, its time over plain exact's: at the most
    samples of both, the largest gain of a scene and device first. Fast has the noise of exact, which is told elsewhere."""
    cases = []
    for result in results["tradeoffs"]:
        groups = curves(result)
        for (device, name), points in groups.items():
            plain = {point["samples"]: point for point in groups.get((device, "exact"), [])}
            if name in ("exact", "double") or name.startswith("fast"):
                continue
            known = [point for point in points if point["samples"] in plain and not point["is_bound"]
                     and not plain[point["samples"]]["is_bound"]]
            if known:
                last = known[-1]
                other = plain[last["samples"]]
                cases.append((result["scene"], device_text(result["devices"][device]), name, last["samples"],
                              other["rel_mse"] / last["rel_mse"], last["seconds"] / other["seconds"]))
    return sorted(cases, key=lambda case: (case[0], case[1], -case[4] / case[5]))


def gain_rows(results):
    return [f"| {scene} | {device} | {name} | {samples} | {error:.2f} | {seconds:.2f} | {error / seconds:.2f} |"
            for scene, device, name, samples, error, seconds in gain_cases(results)]


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
                     f"{time_text(point['seconds'])} | {time_text(point['most_seconds']) if point['most_seconds'] else ''} | "
                     f"{'<' if point['is_bound'] else ''}{percent_text(point['rel_rmse'])} | {point['flip']:.4f} | "
                     f"{100 * bias['relative']:+.2g} % ({bias['z']:+.1f}) |")
    lines += ["", *(f"Left out: {what}.  " for what in result["left_out"])]
    way = (result.get("advice") or {}).get("recommended")
    if way:
        lines += ["", f"Recommended for the error of the scene's own settings: `{way['command']}`."]
    return lines + [""]


ERRORS = (0.5, 0.2, 0.1, 0.05, 0.02)


def accuracy_rows(results):
    """The exact configurations; those of fast have the same noise."""
    rows = []
    for result in results["tradeoffs"]:
        for (device, name), points in sorted(curves(result).items()):
            if name.startswith(("fast", "double")) or "roulette" in name:
                continue
            cells = []
            for error in ERRORS:
                found = samples_for(points, error)
                cells.append(f"{'~' if found[2] else ''}{count_text(math.ceil(found[0]))} ({time_text(found[1])})"
                             if found else "1")
            half = samples_for_half(points)
            rows.append(f"| {result['scene']} | {device_text(result['devices'][device])} | {name} | "
                        + " | ".join(cells) + f" | {f'{half:.1f}' if half else ''} |")
    return rows


def feature_text(entry):
    lines = [f"### {entry['scene']} on {device_text(entry['device'])}", "",
             f"{entry['width']}x{entry['height']}, {entry['samples']} samples, {entry['rounds']} rounds; "
             f"{measured_text(entry)}. The scene's own: {', '.join(entry['features'])}.", "",
             "| program with | time, times its own | least and most of the rounds | build | code |"
             + (f" sm_{entry['capability']} registers | its code | its build |" if entry.get("nvrtc") else ""),
             "|---|---|---|---|---|" + ("---|---|---|" if entry.get("nvrtc") else "")]
    for program in entry["programs"]:
        line = (f"| {program['features']} | {program['ratio']:.3f} | {program['least_ratio']:.2f} to "
                f"{program['most_ratio']:.2f} | {time_text(program['build_seconds'])} | "
                f"{bytes_text(program['code_bytes'])} |")
        if use := program.get("ptxas"):
            line += f" {use['registers']} | {bytes_text(use['code_bytes'])} | {time_text(use['seconds'])} |"
        lines.append(line)
    limit = f"{100 * FEATURE_LIMIT:.0f} %"
    if dear := beyond(entry):
        lines += ["", f"Would cost more than {limit}, if left in: " + ", ".join(
            f"{name} ({100 * (ratio - 1):.0f} %)" for name, ratio in dear.items()) + "."]
    else:
        lines += ["", f"None would cost more than {limit}, if left in."]
    return lines + [""]


def beyond(entry):
    """Programs of more features whose time differs from the scene's own by more than the limit, and than its repetition
    does."""
    ratios = {program["features"]: program["ratio"] for program in entry["programs"]}
    doubt = max(FEATURE_LIMIT, abs(ratios.get("the same again", 1) - 1))
    return {name.removeprefix("and "): ratio for name, ratio in ratios.items()
            if name not in ("its own features", "the same again") and ratio > 1 + doubt}


def generic_ratio(entry):
    return next(program["ratio"] for program in entry["programs"] if "generic" in program["features"])


def span(values, form="{:.2f}"):
    texts = sorted({form.format(value) for value in values}, key=float)
    return texts[0] if len(texts) == 1 else f"{texts[0]} to {texts[-1]}"


def summary(results):
    """The questions of a reader, and what the results below answer."""
    lines = []
    by_kind = {}
    for case in identity_cases(results):
        by_kind.setdefault("on a GPU" if "NVIDIA" in case[1] else "on a processor", []).append(case)
    parts = []
    for kind, cases in sorted(by_kind.items(), reverse=True):
        said = [case for case in cases if case[3] >= SHORT_SECONDS]
        ratios, doubles = [case[4] for case in said or cases], [case[5] for case in said or cases if case[5]]
        parts.append(f"{kind} {span(ratios)} times the time of `fast`"
                     + (f" (and `double` {span(doubles, '{:.1f}')} times that of `exact`)" if doubles else "")
                     + ("" if said else ", in renders too short to be sure of"))
    if parts:
        lines.append(f"- **What does identity cost, and how much faster is fast?** `exact` takes {'; '.join(parts)}. "
                     "On a processor take `exact`.")
    fast = [(rung, entry["rungs"][0]) for entry in results["rungs"] for rung in entry["rungs"] if rung["rung"] == "fast"]
    if fast:
        clear = [abs(rung["bias"][clearest_channel(rung)]) for rung, _ in fast
                 if abs(rung["z"][clearest_channel(rung)]) >= CLEAR_Z]
        errors = [abs(rung["rel_rmse"] / exact["rel_rmse"] - 1) for rung, exact in fast if "rel_rmse" in rung]
        text = "- **How wrong is fast?** "
        text += (f"Its largest bias that is no chance is {max(clear):.0e} of the mean radiance (a float's step is "
                 f"{FLOAT_STEP:.0e}). " if clear else "It has no bias that is more than chance. ")
        text += (f"Its error against the truth is exact's but for {100 * max(errors):.1g} % of it. " if errors else "")
        lines.append(text + "No eye can tell them apart; a hash can.")
    if gains := [case for case in gain_cases(results) if "roulette" not in case[2]]:
        lines.append("- **How many samples does a bit of accuracy cost?** Four times as many for half the error, with "
                     "plain sampling. Before more samples take what gains most:")
        best = {}
        for case in gains:
            if case[3] < TRUSTED_SAMPLES:
                continue
            if case[:2] not in best or case[4] / case[5] > best[case[:2]][4] / best[case[:2]][5]:
                best[case[:2]] = case
        for scene, device, name, samples, error, seconds in best.values():
            lines.append(f"    - {scene} on {device}: " + (f"`{name}`, {error / seconds:.2g} times less MSE x time "
                         f"({samples} samples)" if error > seconds else "none gains anything"))
    if cases := float_cases(results):
        least, _, entry, _ = cases[0]
        lines.append(f"- **Where does float end and double begin?** Beyond {power_text(least)} samples a pixel, in the worst "
                     f"of {len(cases)} measurements ({entry['scene']}): until then an image's noise is larger than float's "
                     "bias. `double` is for checking, not for pictures.")
    if compiled := [entry for entry in results["features"] if entry["device"]["backend"] != "reference"]:
        lines.append("- **What does a feature cost a scene that does not use it?** Nothing, where rt compiles a program "
                     "for the scene; the generic program takes "
                     f"{span([generic_ratio(entry) for entry in compiled])} times its time. The reference "
                     "backend has to take that for some scenes (below).")
    return [*lines, ""] if lines else []


def page(results):
    results = {**results, "tradeoffs": [undisturbed(result) for result in results["tradeoffs"]]}
    lines = ["# Speed against accuracy", "",
             "<!-- Made by tools/plot_tradeoff.py from docs/tradeoff.json; do not edit. -->", "",
             "For someone who must choose: a precision, a sampler, an estimator, a number of samples. All figures are",
             "measured, on the devices and days that they name. The processors' figures are of a machine with two cores",
             "that other programs shared, and only ratios of one run count: times are the least of some repeats, or, where",
             "no *worst* stands beside them, the seconds of all cores over their number, which others do not lengthen.",
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
    if lines_of_summary := summary(results):
        lines += ["## In short", "", *lines_of_summary]
    if rows := identity_rows(results):
        lines += ["## What does identity cost, and how much faster is fast?", "",
                  "Time of `exact` (the same bits on every device) over `fast` (what the device does best), and of `double` over",
                  "`exact`. Above 1, identity costs; below, fast is the slower one: what a device calls fast is not always.",
                  "*Error*: of exact over fast.", "",
                  "| scene | device | samples | exact | exact / fast | double / exact | error |",
                  "|---|---|---|---|---|---|---|", *rows, ""]
    if results["rungs"]:
        lines += ["## How wrong is fast?", "",
                  "The rungs take the same random numbers, so images are held against `exact` pixel by pixel. *Ulp*: shares of",
                  "the values that lie so many float steps apart; 0 is the same bits, and from 16 on it is mostly a path that",
                  "went another way. *Bias*: signed mean difference of the channel where it is clearest, over the mean radiance,",
                  "with its z-score: |z| above 4 is a bias and no chance, but may be of no matter. *Error* and *FLIP* are against",
                  "the converged image, noise and all: where they are as exact's, no eye will see the difference. `matte` to",
                  "`many-spheres` are small scenes of one feature each. Indented rows are of fast with one of its approximations",
                  "alone, and tell which operation a bias comes from.", "", *bias_lines(results)]
        devices = {}
        for entry in results["rungs"]:
            devices.setdefault(device_text(entry["device"]), []).append(entry)
        for device, entries in devices.items():
            lines += rung_text(device, entries)
    if rows := float_rows(results):
        lines += ["## Where does float end and double begin?", "",
                  "Not where one might think: the noise of an image is larger than float's rounding until a great many",
                  "samples. *Noise* and *apart* are RMSEs: of exact against the truth with these samples, and of exact",
                  "against double with the same random numbers; most of the latter is paths that a last bit sends another",
                  "way, which is noise as well and falls with the samples as noise does. What remains of float in the end",
                  "is its bias. One below 6e-8 is of the size of a float's step: the scene's own numbers are rounded too",
                  "(0.8 is 1.5e-8 too large as a float), which all samples share, so that it is certain (a large |z|) and",
                  "of no matter. *Float ends*: samples a pixel at which the error has fallen to that bias; `beyond` where",
                  "the bias may be chance. Scenes where double is worth its time come first.", "",
                  "| scene | device | noise | apart | noise / apart | float's bias (z) | float ends | double, times exact's time |",
                  "|---|---|---|---|---|---|---|---|", *rows, ""]
    if rows := accuracy_rows(results):
        lines += ["## How many samples does a bit of accuracy cost?", "",
                  "Half the error costs four times the samples, by chance alone; the last column is what it costs each sampler.",
                  "Samples, and time at the size measured, for an error, between measured numbers of samples; `~`: beyond",
                  "them, by the root. `1`: one sample is better than that. Rungs have the same noise to many digits.", "",
                  f"| scene | device | configuration | {' | '.join(f'{100 * error:.0f} %' for error in ERRORS)} | half |",
                  "|---|---|---" + "|---" * len(ERRORS) + "|---|", *rows, ""]
    lines += ["## What do samplers and estimators gain?", ""]
    if rows := gain_rows(results):
        lines += ["MSE and time against plain `exact` at the same number of samples; the gain is the one over the other. The MSE",
                  "of a scene of rare bright paths (cornell, and more so lamp, whose metal throws light onto the matte) is itself",
                  "known to a factor of two or so: take the magnitude, and compare rows of the same number of samples only.",
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
                  "`the same again` is the scene's own program once more: what differs by no more is no difference.",
                  "A feature moves a program's registers and time either way: compilers order the same code otherwise.", "",
                  "The reference backend is the exception: it has programs compiled beforehand, for the masks that shipped",
                  "scenes need and for what a user may ask for beside (`backends/reference/ReferenceVariants.cmake`). A",
                  "scene takes the smallest that serves it, and where that is the generic one pays for all features.", ""]
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
        plot(undisturbed(json.loads(Path(options.result).read_text())), options.output)
        return
    results = load("tradeoff", ("tradeoffs", "rungs", "features"))
    if options.check:
        check("tradeoff", page(results))
        return
    for path in options.add:
        add(results, json.loads(Path(path).read_text()), path)
    keep("tradeoff", results, page(results))
    for result in results["tradeoffs"]:
        plot(undisturbed(result), IMAGES / plot_name(result))


main()
