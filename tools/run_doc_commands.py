#!/usr/bin/env python3
"""Runs the commands of a document's ```console blocks and writes what they print below them.

    tools/run_doc_commands.py docs/porting.md
    tools/run_doc_commands.py docs/porting.md build "rt verify"

A line "$ command" is run by bash in the root of the checkout, with the build's programs on the PATH and an empty
directory as $TMPDIR, which all commands of the document share. What it prints, errors included, replaces the lines up
to the next command or the end of the block; a status other than 0 is told in a line of its own.
"""
import argparse
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
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("document", type=pathlib.Path)
    parser.add_argument("build", nargs="?", default="build", help="where the programs are (build)")
    parser.add_argument("text", nargs="?", default="", help="run only the commands that contain this; the others keep "
                                                            "what stands below them")
    options = parser.parse_args()
    document, build = options.document, (ROOT / options.build).resolve()
    with tempfile.TemporaryDirectory() as scratch:
        environment = dict(os.environ, NO_COLOR="1", TMPDIR=scratch, PATH=f"{build}:{os.environ['PATH']}")
        text = rewritten(document.read_text(encoding="utf-8"), options.text, environment)
    document.write_text(text, encoding="utf-8")


main()
