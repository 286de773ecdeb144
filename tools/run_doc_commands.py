#!/usr/bin/env python3
"""Runs the commands of a document's ```console blocks and writes what they print below them.

usage: tools/run_doc_commands.py docs/porting.md [BUILD_DIR [TEXT]]

BUILD_DIR is `build` if it is not given; with TEXT only the commands that contain it are run, and the others keep what
stands below them.

A line "$ command" is run by bash in the root of the checkout, with BUILD_DIR's programs on the PATH and an empty
directory as $TMPDIR, which all commands of the document share. What it prints, errors included, replaces the lines up
to the next command or the end of the block; a status other than 0 is told in a line of its own.
"""
import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parent.parent


def output_of(command, environment):
    print("$", command, file=sys.stderr, flush=True)
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], cwd=ROOT, env=environment, text=True,
                          stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    lines = [line.rstrip() for line in done.stdout.splitlines()]
    if done.returncode != 0:
        lines.append(f"[exit status {done.returncode}]")
    return lines


def rewritten(text, only, environment):
    result = []
    in_block = is_replaced = False
    for line in text.splitlines():
        if line.startswith("```"):
            in_block = line == "```console"
            is_replaced = False
        is_command = in_block and line.startswith("$ ")
        if is_command:
            is_replaced = only in line
        if is_command or not is_replaced:
            result.append(line)
        if is_command and is_replaced:
            result.extend(output_of(line[2:], environment))
    return "\n".join(result) + "\n"


def main():
    if not 2 <= len(sys.argv) <= 4:
        sys.exit(__doc__)
    document = pathlib.Path(sys.argv[1])
    build = (ROOT / (sys.argv[2] if len(sys.argv) > 2 else "build")).resolve()
    only = sys.argv[3] if len(sys.argv) > 3 else ""
    with tempfile.TemporaryDirectory() as scratch:
        environment = dict(os.environ, NO_COLOR="1", TMPDIR=scratch, PATH=f"{build}:{os.environ['PATH']}")
        document.write_text(rewritten(document.read_text(encoding="utf-8"), only, environment), encoding="utf-8")


main()
