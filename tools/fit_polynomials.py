#!/usr/bin/env python3
"""Fits the polynomials of kernels/math.h and kernels/math_double.h and prints their coefficients as hex floats.

Minimax by Remez's exchange in 50 digits (needs mpmath), then each coefficient rounded to float, or with --double to
double. The error of the evaluation, not of the fit, is what tests/test_contract.cpp and tests/test_precision.cpp bound.

    sin(pi/2 f) / f   in f^2, |f| <= 1/2, relative error
    cos(pi/2 f)       in f^2, |f| <= 1/2, 1 at 0, absolute error
    atan(t) / (2 pi t) in t^2, 0 <= t <= 1, relative error
"""
import struct
import sys

from mpmath import atan, cos, lu_solve, matrix, mp, mpf, pi, sin, sqrt

mp.dps = 50
GRID = 600


def remez(function, weight, low, high, count):
    """Coefficients of the polynomial of `count` terms that minimises the largest |weight (function - polynomial)|."""
    points = [(low + high) / 2 - (high - low) / 2 * cos(pi * (2 * i + 1) / (2 * (count + 1))) for i in range(count + 1)]
    for _ in range(30):
        system, right = matrix(count + 1, count + 1), matrix(count + 1, 1)
        for i, x in enumerate(points):
            for j in range(count):
                system[i, j] = x**j
            system[i, count] = (-1) ** i / weight(x)
            right[i] = function(x)
        solution = lu_solve(system, right)
        coefficients = [solution[j] for j in range(count)]
        xs = [low + (high - low) * mpf(i) / GRID for i in range(GRID + 1)]
        errors = [weight(x) * (function(x) - sum(c * x**j for j, c in enumerate(coefficients))) for x in xs]
        # The largest error of each run of one sign is an extremum of the alternation.
        extrema = []
        for i, error in enumerate(errors):
            if extrema and (errors[extrema[-1]] > 0) == (error > 0):
                if abs(error) > abs(errors[extrema[-1]]):
                    extrema[-1] = i
            else:
                extrema.append(i)
        while len(extrema) > count + 1:
            extrema.pop(0 if abs(errors[extrema[0]]) < abs(errors[extrema[-1]]) else -1)
        moved = [xs[i] for i in extrema]
        if len(moved) < count + 1 or max(abs(a - b) for a, b in zip(moved, points)) < mpf(10) ** -12:
            break
        points = moved
    return coefficients, max(abs(error) for error in errors)


def show(name, form, coefficients, error):
    rounded = [struct.unpack(form, struct.pack(form, float(c)))[0].hex() for c in coefficients]
    print(f"{name}: error of the fit {mp.nstr(error, 3)}")
    for power, text in enumerate(rounded):
        print(f"  {power}: {text}")


def main():
    quarter = pi / 2
    near_zero = mpf(2) ** -40

    def sine(x):
        return sin(quarter * sqrt(x)) / sqrt(x) if x > near_zero else quarter - quarter**3 / 6 * x

    def cosine(x):
        return (cos(quarter * sqrt(x)) - 1) / x if x > near_zero else -(quarter**2) / 2

    def angle(x):
        return (atan(sqrt(x)) / sqrt(x) if x > near_zero else 1 - x / 3) / (2 * pi)

    # The terms that bring the error of the fit below that of rounding.
    form, terms_sine, terms_cosine, terms_angle = ("d", 7, 7, 22) if "--double" in sys.argv[1:] else ("f", 4, 4, 9)
    half2 = mpf(1) / 4  # (1/2)^2
    show("sine", form, *remez(sine, lambda x: 1 / sine(x), mpf(0), half2, terms_sine))
    show("cosine - 1, from the power 1", form,
         *remez(cosine, lambda x: x + mpf("1e-3"), mpf(0), half2, terms_cosine))
    show("arctangent in turns", form, *remez(angle, lambda x: 1 / angle(x), mpf(0), mpf(1), terms_angle))


main()
