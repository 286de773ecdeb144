#!/usr/bin/env python3
"""Makes the small inputs from which fuzzing starts: tests/fuzz/corpus/TARGET/ and tests/fuzz/scene.dict.

    make_fuzz_corpus.py            writes all files
    make_fuzz_corpus.py --check    compares them with newly made ones, writes nothing

One input for each thing that a reader does, as small as it can be: fuzzers change inputs byte by byte. Files that
stand for a mended finding are added by hand; their names begin with "finding-" and are left alone here. The JPEG target
starts from tests/data/textures too. Python's standard library only; XXH3 is not in it, so films end
with a checksum of zeros, which the target puts right.
"""
import json
import os
import struct
import sys
import zlib

ROOT = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..")
CORPUS = os.path.join(ROOT, "tests", "fuzz", "corpus")


# --- scenes ---


def scene(**parts):
    whole = {
        "rt": 1,
        "camera": {"from": [0, 0, -2], "at": [0, 0, 1]},
        "sky": {"kind": "none"},
        "materials": {"a": {"kind": "lambertian", "albedo": [0.5, 0.5, 0.5]}},
        "spheres": [{"center": [0, 0, 1], "radius": 0.5, "material": "a"}],
    }
    whole.update(parts)
    return json.dumps(whole, indent="\t").encode()


def scenes():
    sphere = {"center": [0, 0, 1], "radius": -0.5, "material": "a"}
    yield "plain", scene()
    yield "camera", scene(
        camera={"from": [1e3, 2, -2e-3], "at": [0, 0, 1], "up": [0, 1, 0.1], "vfov": 60, "aperture": 0.1, "focus": 3}
    )
    yield "skies", scene(sky={"kind": "gradient", "bottom": [1, 1, 1], "top": [0.5, 0.7, 1]})
    yield "settings", scene(
        sky={"kind": "constant", "color": [1, 1, 1]},
        render={"width": 32, "height": 16, "samples": 4, "max_depth": 5, "seed": 7},
    )
    yield "materials", scene(
        textures={"t": {"kind": "checker", "size": 0.1, "even": [0, 0, 0], "odd": [1, 1, 1]}},
        materials={
            "a": {"kind": "lambertian", "texture": "t", "emission": [1, 0, 0]},
            "m": {"kind": "metal", "albedo": [0.7, 0.6, 0.5], "fuzz": 0.1},
            "g": {"kind": "dielectric", "ior": 1.5},
            "l": {"kind": "light", "emission": [4, 4, 4]},
        },
        spheres=[dict(sphere, material=m) for m in "amgl"],
    )
    yield "files", scene(
        textures={"t": {"kind": "image", "file": "t.png"}},
        sphere_sets=[
            {"file": "s", "format": "f32le-xyzr", "material": "a"},
            {"file": "s", "format": "f32le-xyzr", "materials_file": "m", "materials": ["a"]},
        ],
    )
    yield "keyframes", scene(
        camera=[
            {"frame": 0, "from": [0, 0, -3], "at": [0, 0, 1]},
            {"frame": 8, "from": [0, 1, -2], "at": [0, 0, 1], "vfov": 20},
        ],
        spheres=[[dict(sphere, frame=0), dict(sphere, frame=9.5, center=[1, 0, 1], radius=-2)]],
    )
    yield "text", b'{"rt": 1, "name": "\\u00e9\\ud83d\\ude00\\n", "comment": ["a", null, true, -0.0, 1e400, 1E-400], "x": {}}'


def dictionary():
    """Keys and choices of the scene's schema, in libFuzzer's syntax."""
    words = set()

    def walk(node):
        if isinstance(node, dict):
            words.update(node.get("properties", {}))
            words.update(w for w in node.get("enum", []) if isinstance(w, str))
            if isinstance(node.get("const"), str):
                words.add(node["const"])
            for child in node.values():
                walk(child)
        elif isinstance(node, list):
            for child in node:
                walk(child)

    with open(os.path.join(ROOT, "scenes", "scene.schema.json")) as file:
        walk(json.load(file))
    numbers = ["1e308", "-1e-308", "5e-324", "1e12", "4294967296", "-0", "null", "true", "\\\\u0000", "\\\\ud800"]
    lines = [f'"\\"{word}\\""' for word in sorted(words)] + [f'"{number}"' for number in numbers]
    head = "# Words of scene files for libFuzzer; made by tools/make_fuzz_corpus.py.\n"
    return (head + "\n".join(lines) + "\n").encode()


# --- sphere sets: a byte for the fuzz target, spheres, indices ---


def sphere_sets():
    two = struct.pack("<8f", 1, 2, 3, 0.1, -4, -0.0, 6, -7)
    yield "one-material", b"\x01" + two
    yield "indexed", b"\x82" + two + struct.pack("<2I", 1, 0)
    yield "extremes", b"\x01" + struct.pack("<4f", 1e12, -1e-38, 1e-45, 2.0**30)
    yield "no-numbers", b"\x01" + struct.pack("<4I", 0x7F800000, 0xFFC00000, 0, 0x00000001)


# --- PNG ---


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def png(width, height, depth, colour, rows, before=b"", interlaced=0):
    header = struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, interlaced)
    data = zlib.compress(b"".join(rows), 9)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + before + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def pngs():
    palette = chunk(b"PLTE", bytes(range(12)))
    yield "grey-1", png(9, 2, 1, 0, [b"\0\xa5\x80", b"\0\x5a\x00"])
    yield "grey-16", png(2, 1, 16, 0, [b"\0\x12\x34\x56\x78"])
    yield "rgb-8-filters", png(2, 5, 8, 2, [bytes([f]) + bytes(range(6)) for f in range(5)])
    yield "palette-2", png(5, 2, 2, 3, [b"\0\x1b\x00", b"\0\xe4\x40"], palette + chunk(b"tRNS", b"\x00\x80"))
    yield "grey-alpha", png(2, 1, 8, 4, [b"\0\x01\x02\x03\x04"])
    yield "rgba-16", png(1, 1, 16, 6, [b"\0" + bytes(range(8))])
    interlaced = [b"\0" + bytes([i]) for i in range(4)] + [b"\0\1\2", b"\0\3\4", b"\0" + bytes(4)] * 2
    yield "interlaced", png(4, 4, 8, 0, interlaced, interlaced=1)
    chunks = chunk(b"gAMA", struct.pack(">I", 45455)) + chunk(b"tEXt", b"Title\0rt") + chunk(b"abCd", b"x")
    yield "chunks", png(1, 1, 8, 2, [b"\0\1\2\3"], chunks)
    yield "large-claim", png(16384, 16384, 8, 6, [b"\0"])


# --- JPEG ---


def jpegs():
    folder = os.path.join(ROOT, "tests", "data", "textures")
    for name in ("halves", "halves_progressive"):
        with open(os.path.join(folder, name + ".jpg"), "rb") as file:
            data = file.read()
        # Start of frame, baseline or progressive: length, precision, height, width.
        at = max(data.find(b"\xff\xc0\0\x11"), data.find(b"\xff\xc2\0\x11"))
        assert at > 0
        yield name + "-large-claim", data[: at + 5] + struct.pack(">HH", 16384, 16384) + data[at + 9 :]


# --- films (docs/formats.md) ---


def film(width, height, window, exponent, provenance, samples, sums):
    texts = [text.encode() for pair in provenance for text in pair]
    strings = b"".join(struct.pack("<I", len(text)) + text for text in texts)
    counts = struct.pack(f"<{len(samples)}I", *samples) + struct.pack(f"<{len(sums)}q", *sums)
    head = struct.pack("<IIIIIIIiQQII", 1, width, height, *window, exponent, 7, 1, len(provenance), len(strings))
    return b"RTFILM\r\n" + head + strings + counts + bytes(16)


def films():
    yield "one-pixel", film(1, 1, (0, 0, 1, 1), 40, [], [2], [1 << 40, 1 << 41, 3])
    yield "provenance", film(4, 3, (2, 1, 2, 1), 38, [("Software", "rt"), ("Seed", "0")], [1, 2], [1, 2, 3, 4, 5, 6])
    most = (1 << 63) - 1
    yield "extremes", film(2, 1, (0, 0, 2, 1), -256, [], [0, 0xFFFFFFFF], [most, -most - 1, -1, 0, most, 1])


# --- images that `rt compare` reads: PFM and EXR; PNG and films are the other targets' ---


def exr(kind, values):
    """Two pixels beside each other, channels B, G, R, not compressed (OpenEXR's file layout)."""

    def attribute(name, type_name, data):
        return name + b"\0" + type_name + b"\0" + struct.pack("<i", len(data)) + data

    channels = b"".join(c + b"\0" + struct.pack("<iB3xii", kind, 0, 1, 1) for c in (b"B", b"G", b"R")) + b"\0"
    box = struct.pack("<4i", 0, 0, 1, 0)
    head = struct.pack("<ii", 20000630, 2)
    head += attribute(b"channels", b"chlist", channels) + attribute(b"compression", b"compression", b"\0")
    head += attribute(b"dataWindow", b"box2i", box) + attribute(b"displayWindow", b"box2i", box)
    head += attribute(b"lineOrder", b"lineOrder", b"\0") + attribute(b"pixelAspectRatio", b"float", struct.pack("<f", 1))
    head += attribute(b"rt:Seed", b"string", b"7")
    head += attribute(b"screenWindowCenter", b"v2f", struct.pack("<2f", 0, 0))
    head += attribute(b"screenWindowWidth", b"float", struct.pack("<f", 1)) + b"\0"
    row = struct.pack("<6f" if kind == 2 else "<6e", *values)
    return head + struct.pack("<Q", len(head) + 8) + struct.pack("<ii", 0, len(row)) + row


def images():
    yield "exr-float", exr(2, [0, 0.5, 1, 2, -1, 1e30])
    yield "exr-half", exr(1, [0, 0.5, 1, 2, -1, 1e4])
    yield "pfm", b"PF\n2 1\n-1.0\n" + struct.pack("<6f", 0, 0.5, 1, 2, -1, 1e30)
    yield "pfm-grey-big-endian", b"Pf\n1 2\n1.0\n" + struct.pack(">2f", 1, 2)


# --- files ---


def all_files():
    targets = {"scene": scenes, "spheres": sphere_sets, "png": pngs, "jpeg": jpegs, "rtfilm": films, "image": images}
    for target, inputs in targets.items():
        for name, data in inputs():
            yield os.path.join(CORPUS, target, name), data
    yield os.path.join(ROOT, "tests", "fuzz", "scene.dict"), dictionary()


def main():
    check = sys.argv[1:] == ["--check"]
    if sys.argv[1:] and not check:
        sys.exit("usage: make_fuzz_corpus.py [--check]")
    wrong = 0
    for path, data in all_files():
        if check:
            old = open(path, "rb").read() if os.path.exists(path) else None
            if old != data:
                print(f"{os.path.relpath(path, ROOT)} is not what tools/make_fuzz_corpus.py makes: run it")
                wrong += 1
        else:
            os.makedirs(os.path.dirname(path), exist_ok=True)
            with open(path, "wb") as file:
                file.write(data)
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
