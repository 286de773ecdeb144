#!/usr/bin/env python3
"""Says whether docs/contract.md names a test for each of its 22 rules, and only tests that exist.

usage: tools/check_rules.py

- Its table of the rules' tests has every rule. In each test program that it names there is a test with the rule's
  number in its name ("rule 4: ...", "rules 4 and 13: ..."); a rule without a program says "nothing to test yet".
- Each rule has its section, and what stands in quotes behind *Shown* there is (the end of) a test's name, or an item
  of the self-test.

Exit status: 0 if so, 1 if not.
"""
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
RULES = range(1, 23)


def test_names():
    """By test program: the names of its tests, each literal of a name put together."""
    names = {}
    for path in sorted((ROOT / "tests").glob("test_*.cpp")):
        found = re.findall(r'TEST_CASE\(\s*((?:"(?:[^"\\]|\\.)*"\s*)+)', path.read_text())
        names[path.stem] = ["".join(re.findall(r'"((?:[^"\\]|\\.)*)"', name)) for name in found]
    return names


def rules_in(name):
    """The rules whose number a test's name carries; {10, 11, 12} of "rules 10, 11 and 12: ..."."""
    match = re.match(r"rules? ([\d, and]+):", name)
    return {int(number) for number in re.findall(r"\d+", match.group(1))} if match else set()


def check(contract, names):
    faults = []
    shown = {program: set().union(*map(rules_in, tests)) for program, tests in names.items()}
    everything = {name for tests in names.values() for name in tests}
    self_test = (ROOT / "backends" / "self_test.cpp").read_text()

    table = contract.split("## The rules' tests", 1)[-1].split("\n## ", 1)[0]
    tested = set()
    for rules, programs in re.findall(r"^\| ([\d, ]+) \| (.+) \|$", table, re.M):
        for rule in (int(number) for number in rules.split(",")):
            named = re.findall(r"\btest_\w+", re.sub(r"\btest_\w+ \(no number\)", "", programs))
            if named or "nothing to test yet" in programs:
                tested.add(rule)
            for program in named:
                if rule not in shown.get(program, ()):
                    faults.append(f"the table says {program} for rule {rule}, and no test there is named so")
    faults += [f"the table names no test for rule {rule}" for rule in RULES if rule not in tested]

    sections = dict(re.findall(r"^### (\d+)\. (.*?)(?=^##)", contract, re.M | re.S))
    faults += [f"rule {rule} has no section" for rule in RULES if str(rule) not in sections]
    for rule, text in sections.items():
        for bullet in re.findall(r"^- \*Shown\*: (.*?)(?=^- \*|\Z)", text, re.M | re.S):
            for quoted in re.findall(r'"([^"]+)"', " ".join(bullet.split())):
                if not any(name.endswith(quoted) or quoted + "," in name for name in everything) and f'"{quoted}"' not in self_test:
                    faults.append(f'rule {rule} names "{quoted}", and no test is called so')
    return faults


def main():
    contract = (ROOT / "docs" / "contract.md").read_text()
    names = test_names()
    # The control: a document that names a test too few and one too many.
    planted = contract.replace("| 10 | test_", "| 99 | test_").replace('"rule', '"no such').replace("- *Shown*: ", '- *Shown*: "no such test" ')
    if len(check(planted, names)) < 20:
        sys.exit("check_rules: planted faults are not found")
    faults = check(contract, names)
    for fault in faults:
        print(f"docs/contract.md: {fault}", file=sys.stderr)
    sys.exit(1 if faults else 0)


if __name__ == "__main__":
    main()
