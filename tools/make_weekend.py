#!/usr/bin/env python3
"""Writes scenes/weekend.json: the final scene of "Ray Tracing in One Weekend" (P. Shirley, T. D. Black, S. Hollasch)
with coordinates of its own, fixed in the file.

Every number comes from a counter-based integer generator and is a multiple of 1/1000, so the file is the same on every
machine. `make_weekend.py --check` compares instead of writing.
"""
import os
import sys

TARGET = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "scenes", "weekend.json")
MASK = (1 << 64) - 1


def random_thousandths(cell, dimension):
    """A pure function of its arguments: SplitMix64's output function (Steele, Lea and Flood 2014), 0 to 999."""
    z = ((cell * 16 + dimension + 1) * 0x9E3779B97F4A7C15) & MASK
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK
    return ((z ^ (z >> 31)) >> 32) * 1000 >> 32


def decimal(thousandths):
    """An integer number of thousandths as JSON."""
    sign = "-" if thousandths < 0 else ""
    whole, part = divmod(abs(thousandths), 1000)
    return f"{sign}{whole}" + (f".{part:03}".rstrip("0") if part else "")


def triple(values):
    return "[" + ", ".join(decimal(v) for v in values) + "]"


def small_spheres():
    """Materials and spheres of the 22 x 22 grid, as lines of JSON."""
    materials, spheres = [], []
    for a in range(-11, 11):
        for b in range(-11, 11):
            cell = (a + 11) * 22 + (b + 11)

            def draw(dimension):
                return random_thousandths(cell, dimension)

            x, z = a * 1000 + draw(0) * 9 // 10, b * 1000 + draw(1) * 9 // 10
            # Room for the mirror's foot at (4, 0.2, 0), as in the book; and for the other two large spheres.
            if any((x - foot) ** 2 + z**2 <= 900**2 for foot in (-4000, 0, 4000)):
                continue
            kind = draw(2)
            if kind < 800:
                albedo = [draw(3 + k) * draw(6 + k) // 1000 for k in range(3)]
                name, body = f"matte_{cell}", f'"kind": "lambertian", "albedo": {triple(albedo)}'
            elif kind < 950:
                albedo = [500 + draw(3 + k) // 2 for k in range(3)]
                name = f"metal_{cell}"
                body = f'"kind": "metal", "albedo": {triple(albedo)}, "fuzz": {decimal(draw(6) // 2)}'
            else:
                name, body = "glass", None
            if body:
                materials.append(f'"{name}": {{{body}}}')
            spheres.append(f'{{"center": {triple((x, 200, z))}, "radius": 0.2, "material": "{name}"}}')
    return materials, spheres


def scene():
    materials, spheres = small_spheres()
    materials = [
        '"ground": {"kind": "lambertian", "albedo": [0.5, 0.5, 0.5]}',
        '"glass": {"kind": "dielectric", "ior": 1.5}',
        '"brown": {"kind": "lambertian", "albedo": [0.4, 0.2, 0.1]}',
        '"mirror": {"kind": "metal", "albedo": [0.7, 0.6, 0.5], "fuzz": 0}',
    ] + materials
    spheres = [
        '{"center": [0, -1000, 0], "radius": 1000, "material": "ground"}',
        '{"center": [0, 1, 0], "radius": 1, "material": "glass"}',
        '{"center": [-4, 1, 0], "radius": 1, "material": "brown"}',
        '{"center": [4, 1, 0], "radius": 1, "material": "mirror"}',
    ] + spheres
    return """{
	"rt": 1,
	"$schema": "scene.schema.json",
	"name": "weekend",
	"comment": "The final scene of Ray Tracing in One Weekend with fixed coordinates. Made by tools/make_weekend.py.",
	"camera": {"from": [13, 2, 3], "at": [0, 0, 0], "up": [0, 1, 0], "vfov": 20, "aperture": 0.1, "focus": 10},
	"sky": {"kind": "gradient", "bottom": [1, 1, 1], "top": [0.5, 0.7, 1]},
	"materials": {
		%s
	},
	"spheres": [
		%s
	],
	"render": {"width": 1200, "height": 675, "samples": 128, "max_depth": 50}
}
""" % (",\n\t\t".join(materials), ",\n\t\t".join(spheres))


def main():
    text = scene().encode()
    if sys.argv[1:] == ["--check"]:
        with open(TARGET, "rb") as file:
            if file.read() != text:
                sys.exit("scenes/weekend.json is not what tools/make_weekend.py makes: run it")
        return
    if sys.argv[1:]:
        sys.exit("usage: make_weekend.py [--check]")
    with open(TARGET, "wb") as file:
        file.write(text)


if __name__ == "__main__":
    main()
