#!/usr/bin/env python3
"""Makes the planets' maps in scenes/textures: equirectangular, 512 x 256, 8-bit sRGB PNG.

Python's standard library only. The same texels come out on every machine: sums, products, quotients and square roots
of doubles (which IEEE 754 rounds in one way) and an integer hash; no sine, power or logarithm of a C library. Noise is
taken on the sphere in three dimensions, so a map has no seam at its sides and does not pinch at its poles.

    make_textures.py            writes all maps
    make_textures.py mars       writes one
    make_textures.py --check    compares the texels of the files with newly made ones, writes nothing

Orientation as in the renderer: column 0 is u = 0, row 0 the north pole (+y).
"""
import multiprocessing
import os
import struct
import sys
import zlib
from math import floor, sqrt

WIDTH, HEIGHT = 512, 256
FOLDER = os.path.join(os.path.dirname(os.path.abspath(__file__)), "..", "scenes", "textures")


# --- numbers ---


def circle_table():
    """(cos, sin) of k * pi / 512 for k = 0..1024, by halving a right angle and then rotating."""
    cosine, sine = 0.0, 1.0
    for _ in range(8):
        cosine, sine = sqrt((1 + cosine) / 2), sqrt((1 - cosine) / 2)
    table = [(1.0, 0.0)]
    for _ in range(1024):
        x, y = table[-1]
        table.append((x * cosine - y * sine, x * sine + y * cosine))
    return table


CIRCLE = circle_table()


def point(column, row):
    """The unit vector of a texel's centre: u = phi / 2 pi, x = -cos phi sin theta, z = sin phi sin theta, y up."""
    y, ring = CIRCLE[2 * row + 1]
    cosine, sine = CIRCLE[2 * column + 1]
    return -cosine * ring, y, sine * ring


def hash32(a, b, c, d):
    """32 mixed bits of four integers."""
    h = (a * 0x8DA6B343 ^ b * 0xD8163841 ^ c * 0xCB1AB31F ^ d * 0x165667B1) & 0xFFFFFFFF
    h = ((h ^ h >> 16) * 0x7FEB352D) & 0xFFFFFFFF
    h = ((h ^ h >> 15) * 0x846CA68B) & 0xFFFFFFFF
    return h ^ h >> 16


def unit_random(index, dimension, seed):
    return hash32(index, dimension, seed, 77) / 4294967296


def clamp(x, low=0.0, high=1.0):
    return low if x < low else high if x > high else x


def smooth(low, high, x):
    """0 below low, 1 above high, a cubic between."""
    t = clamp((x - low) / (high - low))
    return t * t * (3 - 2 * t)


def mix(a, b, t):
    return tuple(p + (q - p) * t for p, q in zip(a, b))


def ramp(stops, x):
    """A colour from a list of (position, colour), linear between."""
    if x <= stops[0][0]:
        return stops[0][1]
    for (x0, c0), (x1, c1) in zip(stops, stops[1:]):
        if x < x1:
            return mix(c0, c1, (x - x0) / (x1 - x0))
    return stops[-1][1]


# --- noise ---

GRADIENTS = [
    (x, y, z)
    for x in (-1, 0, 1)
    for y in (-1, 0, 1)
    for z in (-1, 0, 1)
    if abs(x) + abs(y) + abs(z) == 2
]


class Noise:
    """Gradient noise (Perlin 2002) with our own hash, about -1 to 1; lattice gradients are remembered."""

    def __init__(self, seed):
        self.seed = seed
        self.cells = {}

    def cell(self, key):
        x, y, z = key
        corners = [
            GRADIENTS[hash32(x + i, y + j, z + k, self.seed) * 12 >> 32]
            for k in (0, 1)
            for j in (0, 1)
            for i in (0, 1)
        ]
        flat = tuple(component for corner in corners for component in corner)
        self.cells[key] = flat
        return flat

    def __call__(self, x, y, z):
        ix, iy, iz = floor(x), floor(y), floor(z)
        g = self.cells.get((ix, iy, iz)) or self.cell((ix, iy, iz))
        x, y, z = x - ix, y - iy, z - iz
        X, Y, Z = x - 1, y - 1, z - 1
        u = x * x * x * (x * (x * 6 - 15) + 10)
        v = y * y * y * (y * (y * 6 - 15) + 10)
        w = z * z * z * (z * (z * 6 - 15) + 10)
        a = g[0] * x + g[1] * y + g[2] * z
        a += u * (g[3] * X + g[4] * y + g[5] * z - a)
        b = g[6] * x + g[7] * Y + g[8] * z
        b += u * (g[9] * X + g[10] * Y + g[11] * z - b)
        c = g[12] * x + g[13] * y + g[14] * Z
        c += u * (g[15] * X + g[16] * y + g[17] * Z - c)
        d = g[18] * x + g[19] * Y + g[20] * Z
        d += u * (g[21] * X + g[22] * Y + g[23] * Z - d)
        a += v * (b - a)
        c += v * (d - c)
        return a + w * (c - a)

    def fractal(self, x, y, z, octaves, gain=0.5):
        """Octaves of halving strength, about -1 to 1."""
        total, weight = 0.0, 1.0
        for octave in range(octaves):
            total += weight * self(x, y, z)
            weight *= gain
            x, y, z = 2.03 * x + 1.7, 2.03 * y - 3.1, 2.03 * z + 5.3
        return total

    def ridged(self, x, y, z, octaves):
        """Sharp crests, 0 to about 1."""
        total, weight = 0.0, 0.5
        for octave in range(octaves):
            crest = 1 - abs(self(x, y, z))
            total += weight * crest * crest
            weight *= 0.5
            x, y, z = 2.03 * x + 1.7, 2.03 * y - 3.1, 2.03 * z + 5.3
        return total


# --- relief ---


def add_craters(height, count, smallest, largest, seed, depth=1.0):
    """Digs craters with raised rims into a height field; small ones are many, as on real moons."""
    bright = [[0.0] * WIDTH for _ in range(HEIGHT)]
    for index in range(count):
        y = 2 * unit_random(index, 0, seed) - 1
        column = unit_random(index, 1, seed) * WIDTH
        cosine, sine = CIRCLE[int(column) * 2 + 1]
        ring = sqrt(1 - y * y)
        cx, cy, cz = -cosine * ring, y, sine * ring
        # Number above a size falls with its square (Hartmann's law, about); from the inverse distribution.
        u = unit_random(index, 2, seed)
        radius = smallest / sqrt(1 - u * (1 - (smallest / largest) * (smallest / largest)))
        fresh = unit_random(index, 3, seed)
        reach = radius * (4.5 if fresh > 0.93 else 1.7)
        for row in range(HEIGHT):
            row_y, row_ring = CIRCLE[2 * row + 1]
            if abs(row_y - cy) > reach:
                continue
            nearest = min(ring, row_ring)
            half = WIDTH if nearest < 2 * reach else int(reach / nearest * 0.2 * WIDTH) + 2
            first, last = (0, WIDTH) if 2 * half >= WIDTH else (int(column) - half, int(column) + half + 1)
            for unwrapped in range(first, last):
                i = unwrapped % WIDTH
                px, py, pz = point(i, row)
                dx, dy, dz = px - cx, py - cy, pz - cz
                square = dx * dx + dy * dy + dz * dz
                if square > reach * reach:
                    continue
                t = sqrt(square) / radius
                if t < 1:  # a bowl with a flat floor
                    height[row][i] += depth * radius * (smooth(0.45, 1.05, t) * 1.4 - 0.9)
                elif t < 1.7:  # the rim falls away
                    fall = (1.7 - t) / 0.7
                    height[row][i] += depth * radius * 0.5 * fall * fall
                if fresh > 0.93 and t < 4.5:  # rays of young craters
                    ray = hash32(int(24 * (dx + dz) / (t * radius)), int(24 * dy / (t * radius)), index, seed) >> 31
                    bright[row][i] += (0.4 + 0.6 * ray) * (1 - t / 4.5) * (1 - t / 4.5)
    return bright


def relief(height, column, row, strength):
    """Light from the north-west on a height field, about -1 to 1; slopes east are softened where columns crowd."""
    ring = max(CIRCLE[2 * row + 1][1], 0.2)
    east = height[row][(column + 1) % WIDTH] - height[row][column - 1]
    north = height[max(row - 1, 0)][column] - height[min(row + 1, HEIGHT - 1)][column]
    return clamp(strength * (0.8 * east / ring - 0.6 * north), -1, 1)


# --- the planets: each returns rows of (r, g, b), 0 to 255 ---


def texels(colour_at):
    return [[colour_at(i, j) for i in range(WIDTH)] for j in range(HEIGHT)]


def mercury():
    noise, fine = Noise(11), Noise(12)
    height = texels(lambda i, j: 0.05 * noise.fractal(*(2.2 * c for c in point(i, j)), 6))
    rays = add_craters(height, 900, 0.012, 0.19, 13)

    def colour(i, j):
        p = point(i, j)
        plains = smooth(-0.35, 0.45, noise.fractal(*(1.3 * c + 9 for c in p), 4))
        grain = fine.fractal(*(24 * c for c in p), 2)
        base = mix((104, 97, 92), (158, 148, 138), plains)
        light = 1 + 0.55 * relief(height, i, j, 13) + 0.06 * grain + 0.45 * clamp(rays[j][i], 0, 1)
        return tuple(light * c for c in base)

    return texels(colour)


def venus():
    flow, band = Noise(21), Noise(22)
    stops = [
        (-0.75, (178, 124, 62)),
        (-0.3, (206, 154, 84)),
        (0.0, (226, 184, 116)),
        (0.35, (240, 212, 154)),
        (0.75, (250, 236, 196)),
    ]

    def colour(i, j):
        x, y, z = point(i, j)
        # Clouds stream west and towards the poles, so the bands are bent into a lying V.
        bend = 0.55 * y * y
        wx = flow.fractal(1.4 * x, 2.2 * y, 1.4 * z, 4)
        wy = flow.fractal(1.4 * x + 7, 2.2 * y + 3, 1.4 * z - 5, 4)
        a = x + bend * z + 0.25 * wx
        c = z - bend * x + 0.25 * wy
        streak = band.fractal(1.1 * a, 5.5 * (y + 0.16 * wy), 1.1 * c, 5)
        cap = smooth(0.72, 1.0, abs(y))
        return ramp(stops, 0.9 * streak + 0.2 * wx + 0.25 * cap + 0.08)

    return texels(colour)


def earth():
    land, warp, damp, sky = Noise(31), Noise(32), Noise(33), Noise(34)
    ocean_stops = [(-0.7, (6, 20, 60)), (-0.25, (12, 42, 96)), (-0.06, (22, 76, 132)), (0.0, (60, 134, 160))]

    def height_at(x, y, z):
        wx = warp.fractal(1.6 * x, 1.6 * y, 1.6 * z, 3)
        wz = warp.fractal(1.6 * x + 11, 1.6 * y - 4, 1.6 * z + 2, 3)
        return land.fractal(1.25 * x + 0.45 * wx, 1.25 * y, 1.25 * z + 0.45 * wz, 7, 0.55) - 0.1

    height = texels(lambda i, j: height_at(*point(i, j)))

    def ground(i, j, x, y, z):
        h = height[j][i]
        cold = abs(y) + 0.10 * damp.fractal(5 * x, 5 * y, 5 * z, 3)
        if h < 0:
            return mix(ramp(ocean_stops, h), (226, 236, 242), smooth(0.93, 0.96, cold))
        # Rain falls at the equator and in the temperate belts; deserts lie between.
        latitude = abs(y + 0.22 * damp.fractal(1.9 * x + 3, 1.9 * y, 1.9 * z - 6, 4))
        belt = smooth(0.30, 0.12, latitude) if latitude < 0.3 else smooth(0.50, 0.68, latitude)
        wet = clamp(0.7 * belt + 0.22 + 0.75 * damp.fractal(2.1 * x, 2.1 * y, 2.1 * z, 5))
        dry_land = mix((206, 176, 120), (168, 132, 84), smooth(0.1, 0.45, h))
        wet_land = mix((52, 88, 44), (76, 86, 56), smooth(0.55, 0.85, cold))
        colour = mix(dry_land, wet_land, smooth(0.2, 0.75, wet))
        colour = mix(colour, (128, 116, 100), smooth(0.35, 0.6, h))
        colour = mix(colour, (122, 118, 98), smooth(0.78, 0.88, cold))
        colour = mix(colour, (240, 244, 248), max(smooth(0.86, 0.93, cold), smooth(0.58, 0.75, h + 0.3 * cold - 0.1)))
        return tuple(c * (1 + 0.30 * relief(height, i, j, 5)) for c in colour)

    def colour(i, j):
        x, y, z = point(i, j)
        base = ground(i, j, x, y, z)
        swirl = sky.fractal(1.7 * x, 2.6 * y, 1.7 * z, 3)
        cloud = sky.fractal(2.4 * x + 0.9 * swirl + 5, 4.2 * y + 0.5 * swirl, 2.4 * z - 0.9 * swirl, 5, 0.54)
        cover = smooth(0.12, 0.75, cloud + 0.1 * swirl)
        return mix(base, (250, 251, 253), 0.92 * cover)

    return texels(colour)


def mars():
    noise, warp, dust = Noise(41), Noise(42), Noise(43)
    height = texels(lambda i, j: 0.07 * noise.fractal(*(2.0 * c + 3 for c in point(i, j)), 7))
    add_craters(height, 260, 0.012, 0.10, 44, 0.5)
    stops = [
        (-0.55, (88, 46, 32)),
        (-0.22, (126, 66, 40)),
        (0.0, (176, 96, 54)),
        (0.3, (204, 126, 76)),
        (0.65, (226, 164, 112)),
    ]

    def colour(i, j):
        x, y, z = point(i, j)
        w = warp.fractal(1.5 * x, 1.5 * y, 1.5 * z, 4)
        # Dark volcanic plains gather south of the equator.
        tone = noise.fractal(1.5 * x + 0.7 * w, 2.0 * y + 0.3 * w, 1.5 * z - 0.7 * w, 7, 0.55)
        tone += 0.2 * y - 0.22 * smooth(0.45, 0.1, abs(y + 0.3)) + 0.08
        light = 1 + 0.34 * relief(height, i, j, 13) + 0.05 * dust.fractal(20 * x, 20 * y, 20 * z, 2)
        base = tuple(c * light for c in ramp(stops, tone))
        edge = 0.06 * warp.fractal(6 * x, 6 * y, 6 * z, 4)
        ice = max(smooth(0.95, 0.965, y + edge), smooth(0.97, 0.98, -y + edge))
        return mix(base, (242, 238, 232), ice)

    return texels(colour)


def jupiter():
    flow, curl, streak = Noise(51), Noise(52), Noise(53)
    # From the south pole to the north pole: belts are brown, zones are cream.
    stops = [
        (-1.0, (104, 96, 96)),
        (-0.86, (128, 116, 108)),
        (-0.74, (162, 142, 124)),
        (-0.66, (206, 190, 166)),
        (-0.60, (168, 132, 104)),
        (-0.52, (222, 208, 186)),
        (-0.40, (230, 216, 192)),
        (-0.34, (176, 118, 82)),
        (-0.22, (150, 92, 62)),
        (-0.14, (190, 138, 98)),
        (-0.08, (238, 226, 204)),
        (0.06, (242, 232, 212)),
        (0.12, (196, 140, 96)),
        (0.18, (146, 86, 54)),
        (0.27, (172, 114, 78)),
        (0.33, (232, 216, 188)),
        (0.44, (224, 206, 176)),
        (0.48, (178, 142, 112)),
        (0.55, (214, 198, 174)),
        (0.64, (170, 148, 130)),
        (0.76, (150, 136, 126)),
        (0.9, (118, 110, 108)),
        (1.0, (98, 94, 98)),
    ]
    spot_x, spot_y, spot_z = point(200, 158)
    # Unit vectors east and north at the spot.
    ring = sqrt(spot_x * spot_x + spot_z * spot_z)
    east = (spot_z / ring, 0.0, -spot_x / ring)
    north = (-spot_y * spot_x / ring, ring, -spot_y * spot_z / ring)

    def colour(i, j):
        x, y, z = point(i, j)
        a = (x * east[0] + z * east[2]) / 0.22
        b = (x * north[0] + y * north[1] + z * north[2]) / 0.105
        here = x * spot_x + y * spot_y + z * spot_z > 0
        q = sqrt(a * a + b * b) if here else 9.0
        # Belts part around the spot.
        push = smooth(2.6, 0.9, q) * (0.10 if b > 0 else -0.08)
        w = flow.fractal(2.2 * x, 7 * y, 2.2 * z, 4)
        eddy = curl.fractal(5 * x + 0.9 * w, 16 * y + 1.2 * w, 5 * z - 0.9 * w, 5, 0.55)
        calm = smooth(1.0, 0.75, abs(y))
        latitude = y - push + calm * (0.016 * w + 0.030 * eddy)
        base = ramp(stops, latitude)
        fibre = streak.fractal(2.5 * x + 0.8 * eddy, 34 * latitude, 2.5 * z + 0.8 * eddy, 3)
        base = tuple(c * (1 + 0.09 * fibre + 0.10 * calm * eddy) for c in base)
        if q < 1.5:
            turn = curl.fractal(3 * q + 0.3 * a, 3 * q + 0.3 * b, 4.5, 3)
            heart = mix((178, 78, 48), (206, 120, 82), clamp(0.5 + 0.9 * turn))
            base = mix(base, (236, 222, 200), 0.8 * smooth(1.45, 1.05, q))
            base = mix(base, heart, smooth(1.02, 0.86, q))
        return base

    return texels(colour)


PLANETS = {"mercury": mercury, "venus": venus, "earth": earth, "mars": mars, "jupiter": jupiter}


# --- PNG ---


def rows_of(name):
    """A map as rows of bytes, all multiples of 3: the noise hides the step, and the files are half as large."""
    return [bytes(3 * int(clamp(c, 0, 255) / 3 + 0.5) for texel in row for c in texel) for row in PLANETS[name]()]


def paeth(a, b, c):
    p = a + b - c
    pa, pb, pc = abs(p - a), abs(p - b), abs(p - c)
    return a if pa <= pb and pa <= pc else b if pb <= pc else c


def filtered(row, above):
    """A row under PNG's fourth filter, Paeth's; it packs these maps about as well as choosing one for each row."""
    out = bytearray([4])
    for i, value in enumerate(row):
        left, corner = (row[i - 3], above[i - 3]) if i >= 3 else (0, 0)
        out.append((value - paeth(left, above[i], corner)) & 255)
    return bytes(out)


def chunk(kind, data):
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def encode_png(rows):
    packed, above = [], bytes(3 * WIDTH)
    for row in rows:
        packed.append(filtered(row, above))
        above = row
    header = struct.pack(">IIBBBBB", WIDTH, HEIGHT, 8, 2, 0, 0, 0)
    data = zlib.compress(b"".join(packed), 9)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"sRGB", b"\0") + chunk(b"IDAT", data) + chunk(b"IEND", b"")
    )


def decode_png(data):
    """The rows of a PNG that encode_png made (other zlibs may pack the same texels into other bytes)."""
    at, packed = 8, b""
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        if data[at + 4 : at + 8] == b"IDAT":
            packed += data[at + 8 : at + 8 + length]
        at += 12 + length
    raw, rows, above = zlib.decompress(packed), [], bytes(3 * WIDTH)
    for start in range(0, len(raw), 3 * WIDTH + 1):
        row = bytearray()
        if raw[start] != 4:
            return None
        for i, value in enumerate(raw[start + 1 : start + 1 + 3 * WIDTH]):
            left, corner = (row[i - 3], above[i - 3]) if i >= 3 else (0, 0)
            row.append((value + paeth(left, above[i], corner)) & 255)
        above = bytes(row)
        rows.append(above)
    return rows


def path_of(name):
    return os.path.join(FOLDER, name + ".png")


def write(name):
    data = encode_png(rows_of(name))
    with open(path_of(name), "wb") as file:
        file.write(data)
    return f"{name}: {len(data)} bytes"


def check(name):
    with open(path_of(name), "rb") as file:
        same = decode_png(file.read()) == rows_of(name)
    return None if same else f"scenes/textures/{name}.png is not what tools/make_textures.py makes: run it"


def main():
    checking = sys.argv[1:] == ["--check"]
    names = [] if checking else sys.argv[1:]
    if any(name not in PLANETS for name in names):
        sys.exit(f"usage: make_textures.py [--check | {' | '.join(PLANETS)}]")
    with multiprocessing.Pool() as pool:
        results = pool.map(check if checking else write, names or list(PLANETS), 1)
    if checking:
        failures = [result for result in results if result]
        if failures:
            sys.exit("\n".join(failures))
        print(f"{len(results)} maps are as made")
    else:
        print("\n".join(results))


if __name__ == "__main__":
    main()
