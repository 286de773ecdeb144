#!/usr/bin/env python3
"""Checks the shared kernel language: common/*.h and kernels/* (docs/contract.md, rules 2 and 3).

usage: tools/lint_kernels.py [--self-test] [--text-only]

Two passes:

text      Names, types, literals and preprocessor conditions that the language does not have, and sums with a
          product as a term: `a * b + c`, `c - (a * b)`, `s += a * b`. Integer expressions are told apart by their
          declarations; where that fails, the comment /* int */ on the line says that the expression is integer.
          It does not help where a float is in sight.
compiled  clang++ compiles the entry points for the host, everything inlined, contraction off. In what it makes, no
          product may reach an operand of a float addition or subtraction, not through variables, structs, functions,
          selections or loops either; there is no double, and no library function but fma and sqrt. In the double rung
          the same holds of double, and there is no float arithmetic. Needs clang++.

What only the fast or the double rung has (rt_compat.h, RT_PRECISION) stands under a condition on it: there alone are
approximations and double literals allowed.

A product by a power of two is exact, so fusing it changes nothing: both passes let it be. The comment /* bare */ on a
line says that its product feeds a bare + or - on purpose (a probe that asks what a compiler makes of it).

--self-test plants faults that each pass must find, and look-alikes that it must not.
Exit status: 0 clean, 1 findings, 2 the lint itself could not run.
"""

import argparse
import re
import shutil
import struct
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COMPAT = "common/rt_compat.h"
# What only one rung has stands between a condition on it and the next #elif, #else or #endif.
RUNG_CONDITIONS = ((re.compile(r"RT_PRECISION == RT_PRECISION_DOUBLE\b"), "double"), (re.compile(r"RT_FAST\("), "fast"))
# The one file that may finish a hardware operation (rule 2).
ROOTS = "kernels/math.h"

INT_TYPES = {"rt_u32", "rt_i32", "rt_u64", "rt_i64", "rt_uint", "rt_int", "rt_mask", "int", "uint", "unsigned"}
FLOAT_TYPES = {"float", "rt_float"}

# The same, in one rung alone.
RUNG_CALLS = {
    "double": {"as_ulong", "as_double", "__fma_rn", "__double_as_longlong", "__longlong_as_double", "__builtin_fma",
               "__dsqrt_rn", "__drcp_rn", "__builtin_sqrt", "double", "ulong"},
    "fast": {"native_sqrt", "native_rsqrt", "native_recip", "native_sin", "native_cos", "__sinf", "__cosf"},
}

# What each target calls the operations that rt_compat.h gives one name.
COMPAT_CALLS = {
    "fma", "sqrt", "any", "select", "as_uint", "as_float", "convert_float", "convert_int", "convert_uint", "vstore",
    "get_global_id", "__fmaf_rn", "__fsqrt_rn", "__frcp_rn", "__any_sync", "__float_as_uint", "__uint_as_float",
    "__builtin_fmaf", "__builtin_sqrtf", "memcpy", "asm", "__asm", "static_cast", "vload", "popcount", "__attribute__",
    "aligned", "__align__", "alignas", "vector_size", "__builtin_convertvector", "__builtin_ctz", "__builtin_signbit",
    "_mm_fmadd_ps", "_mm_sqrt_ps", "_mm_movemask_ps", "_mm256_fmadd_ps", "_mm256_sqrt_ps", "_mm256_movemask_ps",
    "_mm512_fmadd_ps", "_mm512_maskz_sqrt_ps", "_mm512_test_epi32_mask", "_mm512_castps_si512", "as_float4", "as_float8",
    "__builtin_ia32_movmskps", "__builtin_ia32_movmskps256",
    "fmin", "fmax", "fminf", "fmaxf",  # rt_native_min, rt_native_max: of slabs alone
    "__ballot_sync", "__activemask", "__popc", "atomicAdd",  # lanes of a warp; sums of integers
}
KEYWORD_CALLS = {"if", "for", "while", "switch", "return", "sizeof", "defined", "else", "do", "case"}
BANNED_WORDS = {
    "double": "no double: the kernels are float32",
    "volatile": "no volatile",
    "bool": "no bool: masks are rt_mask",
    "size_t": "no size_t: rt_u32",
    "long": "no long: rt_i64",
    "ulong": "no ulong: rt_u64",
    "half": "no half",
    "goto": "no goto",
}
BANNED_CALLS = re.compile(
    r"(native_|half_|fast_)\w+|(pow|exp|log|sin|cos|tan|asin|acos|atan|sinh|cosh|tanh|cbrt|hypot)\w*|"
    r"a?sincos\w*|f?min|f?max|clamp|mad(24|_\w+)?|mul24|dot|cross|length|distance|normalize|mix|step|smoothstep|"
    r"r?sqrtf?|recip|fmaf?|fabsf?|floorf?|ceilf?|rintf?|roundf?|truncf?|fmodf?|ldexpf?|frexpf?|copysignf?|"
    r"divide|sign|__\w+")
VECTOR_TYPES = re.compile(r"(float|double|half|int|uint|long|ulong|short|ushort|char|uchar)(2|3|4|8|16)")
TARGET_MACROS = re.compile(
    r"RT_TARGET_\w+|__OPENCL\w*|__CUDA\w*|__NVCC__|__HIP\w*|__clang\w*|__GNUC\w*|_MSC_VER|__cplusplus|_WIN32|"
    r"__linux__|__x86_64__|__aarch64__|cl_khr_\w+")

TOKEN = re.compile(
    r"(?P<number>(?:0[xX][0-9a-fA-F.]+(?:[pP][+-]?\d+)?|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[fFuUlL]*)"
    r"|(?P<name>[A-Za-z_]\w*)"
    r'|(?P<string>"(?:[^"\\]|\\.)*"|\'(?:[^\'\\]|\\.)*\')'
    r"|(?P<op><<=|>>=|->|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=|##|[^\s\w])")

OPEN = {"(": ")", "[": "]", "{": "}"}


class Token:
    def __init__(self, kind, text, line):
        self.kind, self.text, self.line = kind, text, line

    def __repr__(self):
        return self.text


class Finding:
    def __init__(self, path, line, message):
        self.path, self.line, self.message = path, line, message

    def __str__(self):
        return f"{self.path}:{self.line}: {self.message}"


# ---- text: reading --------------------------------------------------------------------------------------------------


def strip_comments(text):
    """The text without comments, lines kept; and the numbers of the lines that carry each marker."""
    marked = {"int": set(), "bare": set()}

    def blank(match):
        if match.group(0)[0] in "\"'":
            return match.group(0)
        marker = re.fullmatch(r"/\*\s*(int|bare)\b.*\*/", match.group(0))
        if marker:
            marked[marker.group(1)].add(text.count("\n", 0, match.start()) + 1)
        return " " + "\n" * match.group(0).count("\n")

    return re.sub(r'//[^\n]*|/\*.*?\*/|"(?:[^"\\\n]|\\.)*"', blank, text, flags=re.S), marked


def tokens_of(text, first_line):
    result = []
    for match in TOKEN.finditer(text):
        result.append(Token(match.lastgroup, match.group(0), first_line + text.count("\n", 0, match.start())))
    return result


class Source:
    """A file as code tokens, macro bodies and preprocessor conditions."""

    def __init__(self, path, text):
        self.path = path
        text, self.marked = strip_comments(text)
        self.macros = []  # (name, parameters, body tokens)
        self.conditions = []  # (line, text)
        self.rungs = {}  # line: the rung that alone has it
        self.open = []  # of each open #if: the rung it is for, or None
        code, self.includes = [], []
        lines = text.split("\n")
        number = 0
        while number < len(lines):
            start = number
            line = lines[number]
            rung = next((r for r in reversed(self.open) if r), None)
            if rung:
                self.rungs[number + 1] = rung
            if line.lstrip().startswith("#"):
                while line.endswith("\\") and number + 1 < len(lines):
                    number += 1
                    line = line[:-1] + "\n" + lines[number]
                self.directive(line, start + 1)
                code.extend([""] * (number - start + 1))
                for continued in range(start + 2, number + 2):
                    self.rungs[continued] = rung
            else:
                code.append(line)
            number += 1
        self.tokens = tokens_of("\n".join(code), 1)

    def directive(self, line, number):
        match = re.match(r"\s*#\s*(\w+)\s*(.*)", line, flags=re.S)
        if not match:
            return
        word, rest = match.groups()
        if word in ("elif", "else", "endif") and self.open:
            self.open.pop()
        if word in ("if", "ifdef", "ifndef", "elif", "else"):
            only = re.match(r"!|.*\|\|", rest, flags=re.S) is None and word in ("if", "elif")
            self.open.append(next((r for form, r in RUNG_CONDITIONS if only and form.search(rest)), None))
        if word in ("if", "ifdef", "ifndef", "elif"):
            self.conditions.append((number, rest))
        elif word == "define":
            define = re.match(r"(\w+)(\(([^)]*)\))?(.*)", rest, flags=re.S)
            parameters = [p.strip() for p in (define.group(3) or "").split(",") if p.strip()]
            body = tokens_of(define.group(4), number)
            self.macros.append((define.group(1), parameters, body, define.group(2) is not None))
        elif word == "include":
            self.includes.append((number, rest.strip()))


def is_float_literal(text):
    if text[:2] in ("0x", "0X"):
        return "p" in text or "P" in text
    return bool(re.search(r"[.eE]", text)) or text[-1] in "fF"


def value_of(text):
    digits = text.rstrip("fFlL")
    return float.fromhex(digits) if digits[:2] in ("0x", "0X") else float(digits)


def is_float32(text):
    """Is the literal's value a float? (That of a double is enough to tell: 0.1 is no float with 53 digits either.)"""
    value = value_of(text)
    return struct.unpack("f", struct.pack("f", value))[0] == value


def is_exact_factor(text):
    """Is the literal a power of two?"""
    if not is_float_literal(text):
        return False
    value = value_of(text)
    return value > 0 and value.hex().startswith("0x1.0000000000000p")


# ---- text: types ----------------------------------------------------------------------------------------------------


class Types:
    """What names mean: "int", "float", or None where declarations disagree."""

    def __init__(self, sources):
        self.fields, self.functions, self.macros, self.defined = {}, {}, {}, set()
        for source in sources:
            self.read(source)

    @staticmethod
    def kind(type_name):
        return "int" if type_name in INT_TYPES else "float" if type_name in FLOAT_TYPES else "other"

    @staticmethod
    def note(table, name, kind):
        table[name] = kind if table.get(name, kind) == kind else None

    def read(self, source):
        tokens = source.tokens
        depth, struct_depth = 0, None
        for i, token in enumerate(tokens):
            if token.text == "{":
                depth += 1
                if i >= 2 and "struct" in (tokens[i - 1].text, tokens[i - 2].text):
                    struct_depth = depth
            elif token.text == "}":
                if struct_depth == depth:
                    struct_depth = None
                depth -= 1
            elif struct_depth == depth and token.kind == "name":
                for name in self.declared(tokens, i):
                    self.note(self.fields, name, self.kind(token.text))
            elif depth == 0 and token.kind == "name" and i + 2 < len(tokens):
                if tokens[i + 1].kind == "name" and tokens[i + 2].text == "(":
                    self.defined.add(tokens[i + 1].text)
                    self.note(self.functions, tokens[i + 1].text, self.kind(token.text))
        for name, parameters, body, is_function in source.macros:
            self.defined.add(name)
            if not is_function and body and all(t.text in "()-" or t.kind == "number" for t in body):
                kinds = {"float" if is_float_literal(t.text) else "int" for t in body if t.kind == "number"}
                if len(kinds) == 1:
                    self.note(self.macros, name, kinds.pop())

    @staticmethod
    def declared(tokens, i):
        """The names that a declaration whose type is token i declares; empty if it is none."""
        if tokens[i].text not in INT_TYPES | FLOAT_TYPES:
            return
        before = tokens[i - 1].text if i else ";"
        if before not in (";", "{", "}", "(", ",", "const", "RT_PRIVATE", "RT_GLOBAL", "RT_TABLE"):
            return
        j = i + 1
        depth = 0
        expect = True
        # A parameter ends at its comma; a variable's list goes on to the semicolon.
        parameter = before == "," or before == "("
        while j < len(tokens):
            text = tokens[j].text
            if depth == 0 and text in (";", ")", "{") or depth == 0 and parameter and text == ",":
                return
            if text in OPEN:
                if text == "(" and expect:
                    return
                depth += 1
            elif text in (")", "]", "}"):
                depth -= 1
            elif depth == 0 and text == ",":
                expect = True
            elif depth == 0 and expect and tokens[j].kind == "name" and text not in ("const", "RT_RESTRICT"):
                yield text
                expect = False
            j += 1


# ---- text: products in sums -----------------------------------------------------------------------------------------


class SumCheck:
    """Walks the tokens of one file level by level: brackets, then separators, then terms, then factors."""

    # Everything that binds weaker than + and -, and so ends a sum.
    SEPARATORS = {
        ",", ";", "?", ":", "=", "<", ">", "<=", ">=", "==", "!=", "&&", "||", "&", "|", "^", "<<", ">>", "+=", "-=",
        "*=", "/=", "%=", "&=", "|=", "^=", "<<=", ">>=", "return", "else", "do", "case"
    }

    def __init__(self, source, types):
        self.source, self.types = source, types
        self.variables = {}
        self.findings = []

    def run(self):
        tokens = self.source.tokens
        start, depth = 0, 0
        # One function (or declaration) at a time, so that variables are local.
        for i, token in enumerate(tokens):
            depth += token.text == "{"
            depth -= token.text == "}"
            if depth == 0 and token.text in ("}", ";"):
                self.chunk(tokens[start:i + 1])
                start = i + 1
        self.chunk(tokens[start:])
        for _, parameters, body, _ in self.source.macros:
            self.variables = {}
            self.region(body)
        return self.findings

    def chunk(self, tokens):
        self.variables = {}
        for i, token in enumerate(tokens):
            if token.kind == "name":
                for name in Types.declared(tokens, i):
                    Types.note(self.variables, name, Types.kind(token.text))
        self.region(tokens)

    def region(self, tokens):
        """tokens: what stands between two brackets."""
        groups, part, pending = [], [], None
        i = 0
        while i < len(tokens):
            token = tokens[i]
            if token.text in OPEN:
                close = self.matching(tokens, i)
                self.region(tokens[i + 1:close])
                part.append((token, tokens[i + 1:close]))
                i = close
                if token.text == "{":
                    groups.append((pending, part))
                    part, pending = [], None
            elif token.text in self.SEPARATORS:
                groups.append((pending, part))
                part, pending = [], token
            else:
                part.append((token, None))
            i += 1
        groups.append((pending, part))
        left = []
        for separator, part in groups:
            self.sum(part, separator, left)
            left = part

    @staticmethod
    def matching(tokens, i):
        depth = 0
        for j in range(i, len(tokens)):
            depth += tokens[j].text in OPEN
            depth -= tokens[j].text in (")", "]", "}")
            if depth == 0:
                return j
        return len(tokens)

    @staticmethod
    def is_operand(item):
        token, inside = item
        return inside is not None or token.kind in ("number", "name", "string")

    def is_cast(self, part, i):
        token, inside = part[i]
        return (token.text == "(" and inside and all(t.kind == "name" or t.text == "*" for t in inside) and
                inside[0].text in INT_TYPES | FLOAT_TYPES and i + 1 < len(part) and
                (i == 0 or not self.is_operand(part[i - 1])))

    def split(self, part, operators):
        """part cut at the binary operators of this level."""
        pieces, piece = [], []
        for i, item in enumerate(part):
            token, inside = item
            binary = i > 0 and self.is_operand(part[i - 1]) and not self.is_cast(part, i - 1)
            if inside is None and token.text in operators and binary:
                pieces.append(piece)
                piece = []
            else:
                piece.append(item)
        pieces.append(piece)
        return pieces

    def product(self, term):
        """The token of the product that the term is, if it is one that rounds."""
        while term and term[0][1] is None and term[0][0].text in ("-", "+"):
            term = term[1:]
        while term and self.is_cast(term, 0):
            term = term[1:]
        if len(term) == 1 and term[0][1] is not None and term[0][0].text == "(":
            inside = self.nest(term[0][1])
            if len(self.split(inside, ("+", "-"))) > 1:
                return None
            if any(token.text in self.SEPARATORS and sub is None for token, sub in inside):
                return None
            return self.product(inside)
        factors = self.split(term, ("*", "/", "%"))
        if len(factors) < 2:
            return None
        last = None
        for i, item in enumerate(term):
            if item[1] is None and item[0].text in ("*", "/", "%") and i > 0 and self.is_operand(term[i - 1]):
                last = item[0]
        if last is None or last.text != "*":
            return None
        for factor in (factors[-1], factors[0] if len(factors) == 2 else []):
            if len(factor) == 1 and factor[0][0].kind == "number" and is_exact_factor(factor[0][0].text):
                return None
        return last

    def nest(self, tokens):
        items, i = [], 0
        while i < len(tokens):
            if tokens[i].text in OPEN:
                close = self.matching(tokens, i)
                items.append((tokens[i], tokens[i + 1:close]))
                i = close
            else:
                items.append((tokens[i], None))
            i += 1
        return items

    def sum(self, part, separator, left):
        terms = self.split(part, ("+", "-"))
        compound = separator is not None and separator.text in ("+=", "-=")
        if len(terms) < 2 and not compound:
            return
        for term in terms:
            star = self.product(term)
            if star is None:
                continue
            kinds = self.kinds(part) | (self.kinds(left) if compound else set())
            marked = self.source.marked
            if kinds == {"int"} or star.line in marked["bare"] or (star.line in marked["int"] and "float" not in kinds):
                continue
            why = "" if "float" in kinds else " (if it is integer, say so: /* int */)"
            self.findings.append(
                Finding(self.source.path, star.line, f"a product feeds a bare + or -: use rt_fma (rule 3){why}"))

    def kinds(self, part):
        """The kinds of number that an expression is made of."""
        found = set()
        i = 0
        while i < len(part):
            token, inside = part[i]
            follows = part[i + 1] if i + 1 < len(part) else (Token("op", "", 0), None)
            if self.is_cast(part, i):
                found.add("int" if inside[0].text in INT_TYPES else "float")
                i += 2  # what is cast does not matter
                if i < len(part) and part[i][1] is not None:
                    i += 1
                continue
            if token.kind == "number":
                found.add("float" if is_float_literal(token.text) else "int")
            elif token.text == "(" and inside is not None:
                found |= self.kinds(self.nest(inside))
            elif token.kind == "name":
                if token.text in ("blockIdx", "blockDim", "threadIdx"):
                    found.add("int")
                    i += 2
                elif follows[0].text in (".", "->"):
                    pass  # the last field decides
                elif i > 0 and part[i - 1][0].text in (".", "->"):
                    found.add(self.types.fields.get(token.text) or "unknown")
                elif follows[1] is not None and follows[0].text == "(":
                    found.add(self.call(token.text, follows[1]))
                    i += 1
                elif token.text in self.variables:
                    found.add(self.variables[token.text] or "unknown")
                else:
                    found.add("int" if token.text == "RT_GLOBAL_ID" else self.types.macros.get(token.text) or "unknown")
                # An index says nothing about the element.
            i += 1
        return {"unknown" if kind == "other" else kind for kind in found}

    def call(self, name, arguments):
        if name in ("rt_fma", "rt_splat", "rt_to_float", "rt_from_bits", "RT_GATHER_F"):
            return "float"
        if name in ("rt_splat_i", "rt_splat_u", "rt_to_int", "rt_to_uint", "rt_bits", "rt_lane_ids", "RT_GATHER_U"):
            return "int"
        if name == "rt_sel":
            choices, current = [[]], 0
            for item in self.nest(arguments):
                if item[1] is None and item[0].text == ",":
                    choices.append([])
                else:
                    choices[-1].append(item)
            kinds = set().union(*(self.kinds(choice) for choice in choices[1:]))
            return kinds.pop() if len(kinds) == 1 else "unknown"
        return self.types.functions.get(name) or self.types.macros.get(name) or "unknown"


# ---- text: words ----------------------------------------------------------------------------------------------------


def host_only_macros(sources):
    """Constants of common/ without f: for the host's double arithmetic, and no kernel's business."""
    names = set()
    for source in sources:
        if source.path.startswith("common/"):
            for name, _, body, _ in source.macros:
                if any(t.kind == "number" and is_float_literal(t.text) and t.text[-1] not in "fF" for t in body):
                    names.add(name)
    return names


def check_words(source, types, host_only):
    findings = []

    def report(line, message):
        findings.append(Finding(source.path, line, message))

    compat = source.path == COMPAT
    for line, condition in source.conditions:
        if not compat and TARGET_MACROS.search(condition):
            report(line, f"only {COMPAT} asks which compiler this is")
    for line, name in source.includes:
        if not compat and not re.fullmatch(r'"(common|kernels)/\w+\.(h|cl)"', name):
            report(line, f"a kernel includes common/ and kernels/ only, not {name}")
    bodies = [(source.tokens, False)] + [(body, True) for _, _, body, _ in source.macros]
    for tokens, in_macro in bodies:
        for i, token in enumerate(tokens):
            text = token.text
            follows = tokens[i + 1].text if i + 1 < len(tokens) else ""
            before = tokens[i - 1].text if i else ""
            rung = source.rungs.get(token.line)
            if token.kind == "number":
                if rung == "double" and is_float_literal(text):
                    continue
                if is_float_literal(text) and text[-1] not in "fF":
                    if not (in_macro and source.path.startswith("common/") and not compat):
                        report(token.line, f"a literal without f is a double: {text}")
                elif is_float_literal(text) and not is_float32(text):
                    report(token.line, f"no float has this value, and compilers round it: {text}; write it in hex")
                continue
            if token.kind != "name" or before in (".", "->"):
                continue
            if not compat and TARGET_MACROS.fullmatch(text):
                report(token.line, f"only {COMPAT} asks which compiler this is: {text}")
            elif text in host_only and source.path.startswith("kernels/"):
                report(token.line, f"{text} is a double, for the host only")
            elif rung == "double" and compat and text in RUNG_CALLS["double"]:
                pass
            elif text in BANNED_WORDS and not compat:
                report(token.line, BANNED_WORDS[text])
            elif text in BANNED_WORDS and text in ("double", "half", "goto", "bool"):
                report(token.line, BANNED_WORDS[text])
            elif VECTOR_TYPES.fullmatch(text):
                report(token.line, f"no vector type but the lane types: {text}")
            elif follows == "(":
                if text in KEYWORD_CALLS or text in types.defined or re.match(r"(rt|v3)_|RT_", text):
                    continue
                if compat and (text in COMPAT_CALLS or before == "__asm"):
                    continue
                if compat and text in RUNG_CALLS.get(rung, ()):
                    continue
                if in_macro and any(text in parameters for _, parameters, _, _ in source.macros):
                    continue
                if text in INT_TYPES | FLOAT_TYPES | {"char", "void", "name"}:
                    continue
                what = "not a function of the contract" if BANNED_CALLS.fullmatch(text) else "not a function of ours"
                report(token.line, f"{text}() is {what} (rule 2)")
    return findings


def check_text(files):
    """files: {path relative to the root: text}. Returns findings."""
    sources = [Source(path, text) for path, text in files.items()]
    types = Types(sources)
    host_only = host_only_macros(sources)
    findings = []
    for source in sources:
        findings += check_words(source, types, host_only)
        findings += SumCheck(source, types).run()
    return sorted(findings, key=lambda f: (f.path, f.line))


# ---- compiled -------------------------------------------------------------------------------------------------------

CLANG_FLAGS = [
    "-std=c++17", "-O2", "-march=haswell", "-ffp-contract=off", "-fno-fast-math", "-fno-vectorize",
    "-fno-slp-vectorize", "-fno-unroll-loops", "-fno-math-errno", "-mllvm", "-inline-threshold=1000000",
    "-gline-tables-only", "-Wno-everything", "-S", "-emit-llvm"
]
# What a kernel may call once everything of ours is inlined. llvm.* without a float operation are harmless.
# FLOAT stands for the rung's own.
ALLOWED_CALL = (
    r"llvm\.(fma\.FLOAT|fabs\.FLOAT|sqrt\.FLOAT|copysign\.FLOAT|memcpy\.\S+|memset\.\S+|lifetime\.\S+|dbg\.\S+|assume|"
    r"experimental\.noalias\.scope\.decl|threadlocal\.address\S*|[us](min|max|add\.sat|sub\.sat)\.\S+|fsh[lr]\.\S+|"
    r"(bswap|bitreverse|ctpop|ctlz|cttz|abs)\.\S+)|sqrtf|fmaf")


class Module:
    """LLVM's text of one translation unit: its instructions by name, with their places in the source."""

    INSTRUCTION = re.compile(r"\s+(?:(%[\w.]+) = )?(?:tail |musttail |notail )?(\w+) ?(.*)")

    def __init__(self, text):
        self.nodes = {}
        for match in re.finditer(r"^(!\d+) = (?:distinct )?!(DI\w+)\((.*)\)$", text, flags=re.M):
            self.nodes[match.group(1)] = (match.group(2), match.group(3))
        self.functions = {}
        name, body = None, {}
        for line in text.split("\n"):
            define = re.match(r"define .*?@([\w.$]+|\"[^\"]+\")\(", line)
            if define:
                name, body = define.group(1), {}
                self.functions[name] = body
            elif line.startswith("}"):
                name = None
            elif name:
                match = self.INSTRUCTION.match(line)
                if match:
                    key = match.group(1) or f"#{len(body)}"
                    body[key] = (match.group(2), match.group(3))

    def field(self, node, name):
        match = re.search(rf"\b{name}: (!?[\w\"./-]+)", self.nodes.get(node, ("", ""))[1])
        return match.group(1) if match else None

    def places(self, operands):
        """Where an instruction comes from: its own line, then those of the calls that were inlined around it."""
        match = re.search(r"!dbg (!\d+)", operands)
        location = match.group(1) if match else None
        found = []
        while location in self.nodes:
            scope = self.field(location, "scope")
            while scope in self.nodes and not self.field(scope, "file"):
                scope = self.field(scope, "scope")
            filename = (self.field(self.field(scope, "file"), "filename") or "?").strip('"')
            found.append((filename.replace("./", "", 1), int(self.field(location, "line") or 0)))
            location = self.field(location, "inlinedAt")
        return found or [("?", 0)]


def describe(places):
    return ", called at ".join(f"{path}:{line}" for path, line in places[:4])


VALUE = r"(%[\w.]+|-?\d[\w.+]*|0x[0-9A-F]+|undef|poison)"


def exact_constant(text):
    """Is an LLVM float constant plus or minus a power of two?"""
    if re.fullmatch(r"0x[0-9A-F]{16}", text):
        bits = int(text, 16)
        return bits & ((1 << 52) - 1) == 0 and 0 < (bits >> 52) & 0x7FF < 0x7FF
    try:
        value = abs(float(text))
    except ValueError:
        return False
    return value > 0 and value.hex().startswith("0x1.0000000000000p")


def products_behind(body, name, seen):
    """The multiplications whose result `name` may be, unchanged but for its sign."""
    if name in seen or name not in body:
        return set()
    seen.add(name)
    operation, operands = body[name]
    if operation == "fmul":
        factors = re.findall(VALUE, operands.split(", !dbg")[0].split(" ", 1)[1] if " " in operands else operands)
        return set() if any(exact_constant(factor) for factor in factors) else {name}
    found = set()
    if operation == "phi":
        for value in re.findall(r"\[ (%[\w.]+), %", operands):
            found |= products_behind(body, value, seen)
    elif operation in ("fneg", "freeze"):
        for value in re.findall(r"%[\w.]+", operands):
            found |= products_behind(body, value, seen)
    elif operation == "select":
        for value in re.findall(r"(?:float|double) (%[\w.]+)", operands):
            found |= products_behind(body, value, seen)
    return found


def check_module(text, root, in_double=False):
    """in_double: the module is of the double rung, which computes in double and in nothing else."""
    module = Module(text)
    allowed_call = re.compile(ALLOWED_CALL.replace("FLOAT", "f64" if in_double else "f32"))
    wrong_arithmetic = ["fadd", "fsub", "fmul", "fdiv", "frem", "fptrunc" if in_double else "fpext"]
    findings, bare = {}, {}

    def on_purpose(path, line):
        if path not in bare:
            source = root / path
            bare[path] = strip_comments(source.read_text())[1]["bare"] if source.is_file() else set()
        return line in bare[path]

    def report(operands, message):
        places = module.places(operands)
        if len(places) > 1:
            message += "; " + describe(places)
        findings[(places[0], message)] = Finding(*places[0], message)

    for body in module.functions.values():
        for operation, operands in body.values():
            if operation in ("fadd", "fsub"):
                for operand in re.findall(r"%[\w.]+", operands.split(", !dbg")[0]):
                    for product in products_behind(body, operand, set()):
                        if on_purpose(*module.places(operands)[0]):
                            continue
                        origin = describe(module.places(body[product][1]))
                        report(operands, f"a product feeds a bare + or - (rule 3): {origin}")
            if operation in wrong_arithmetic and ("float" if in_double else "double") in operands:
                report(operands, "float arithmetic in the double rung" if in_double else "double arithmetic (rule 2)")
            if operation == "frem":
                report(operands, "a float remainder is a library call (rule 2)")
            if operation == "call":
                callee = re.search(r"@([\w.$]+)\(", operands)
                if callee and not allowed_call.fullmatch(callee.group(1)):
                    if callee.group(1) not in module.functions:
                        report(operands, f"calls {callee.group(1)}, which no device promises (rule 2)")
    return list(findings.values())


def included_with(root, unit):
    """`unit` (paths under root) and the entry files that they include."""
    paths = list(unit)
    for path in paths:
        paths += [p for p in re.findall(r'#include "(kernels/\w+\.cl)"', (root / path).read_text()) if p not in paths]
    return paths


def compile_host(clang, root, unit, defines):
    """LLVM's text of a translation unit that makes every entry point of `unit` (paths under root) visible."""
    entries = []
    for path in (root / p for p in included_with(root, unit)):
        entries += re.findall(r"\bRT_KERNEL\((\w+)\)", strip_comments(path.read_text())[0])
    lines = ['#include "common/rt_compat.h"', "static thread_local rt_u32 rt_host_global_id;"]
    for path in unit:
        lines.append(f'#include "{path}"')
    lines.append("using entry = void (*)();")
    lines.append("extern const entry entries[];")
    lines.append("const entry entries[] = {" + ", ".join(f"reinterpret_cast<entry>({e})" for e in entries) + "};")
    # Read by the entry points, so it must look as if somebody sets it.
    lines.append("void set_global_id(rt_u32 id) { rt_host_global_id = id; }")
    with tempfile.TemporaryDirectory() as work:
        source = Path(work) / "unit.cpp"
        source.write_text("\n".join(lines) + "\n")
        command = [clang, *CLANG_FLAGS, *defines, "-I.", "-o", str(Path(work) / "unit.ll"), str(source)]
        run = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            raise RuntimeError(f"clang++ could not compile {' '.join(unit)} ({' '.join(defines)}):\n{run.stderr[:4000]}")
        return (Path(work) / "unit.ll").read_text(), len(entries)


def check_compiled(clang, root):
    """All entry points, with every feature and with each one left out, with both forms of the roots."""
    texts = {str(p.relative_to(root)): p.read_text() for p in sorted((root / "kernels").glob("*.cl"))}
    # One entry file may include another: then the other is there already.
    unit = [path for path in texts if not any(f'#include "{path}"' in text for text in texts.values())]
    features = re.findall(r"#define (RT_FEATURE_\w+) 0x[0-9a-fA-F]+u\b",
                          (root / "common/rt_features.h").read_text()) if (root / "common/rt_features.h").exists() else []
    variants = [["-DRT_DEF_NATIVE_ROOTS=0"], ["-DRT_DEF_NATIVE_ROOTS=1"]]
    # What goes with a feature, because it needs it (common/rt_features.h).
    needed_by = {"RT_FEATURE_PERMUTED": "RT_FEATURE_BVH", "RT_FEATURE_LAMBERTIAN": "RT_FEATURE_LIGHTS",
                 "RT_FEATURE_EMISSION": "RT_FEATURE_LIGHTS"}
    without = {f: f"{f}&~{needed_by[f]}" if f in needed_by else f for f in features}
    variants += [[f"-DRT_FEATURES=(RT_FEATURE_ALL&~{without[f]})"] for f in features if f != "RT_FEATURE_ALL"]
    findings = {}
    for defines in variants:
        text, count = compile_host(clang, root, unit, defines)
        if count == 0:
            raise RuntimeError("no entry point (RT_KERNEL) in kernels/*.cl")
        for finding in check_module(text, root):
            findings.setdefault(str(finding), finding)
    # The probe asks about float32.
    if "kernels/render.cl" in texts:
        variants.append(["-DRT_PRECISION=2"])
        text, _ = compile_host(clang, root, ["kernels/render.cl"], variants[-1])
        for finding in check_module(text, root, in_double=True):
            findings.setdefault(str(finding), finding)
    return sorted(findings.values(), key=lambda f: (f.path, f.line)), len(variants)


# ---- self-test ------------------------------------------------------------------------------------------------------

TEXT_FAULTS = {
    "product in a sum": "RT_FN rt_float f(rt_float a, rt_float b, rt_float c) { return a * b + c; }",
    "product subtracted": "RT_FN rt_float f(rt_float a, rt_float b, rt_float c) { return c - a * b; }",
    "product in brackets": "RT_FN rt_float f(rt_float a, rt_float b, rt_float c) { return c + (a * b); }",
    "negated product": "RT_FN rt_float f(rt_float a, rt_float b, rt_float c) { return -(a * b) + c; }",
    "compound assignment": "RT_FN rt_float f(rt_float a, rt_float b) { rt_float c = a; c += a * b; return c; }",
    "product in a call": "RT_FN rt_float f(rt_float a, rt_float b) { return rt_fma(a, b, a * b - 1.0f); }",
    "product of fields": "typedef struct s { rt_float p, q; } s;\nRT_FN rt_float f(s a) { return a.p * a.q + a.p; }",
    "product over two lines": "RT_FN rt_float f(rt_float a, rt_float b, rt_float c) { return c +\n\ta * b; }",
    "product in a macro": "#define LERP(a, b, t) ((a) + (t) * ((b) - (a)))",
    "product with an index": "RT_FN rt_float f(RT_GLOBAL const float* a, rt_u32 i) { return a[i] * a[i + 1u] + a[0]; }",
    "int factor, float sum": "RT_FN rt_float f(rt_float a, rt_u32 i) { return rt_to_float(i * 3u) * a + a; }",
    "marker int on floats": "RT_FN rt_float f(rt_float a) { return a * a + a; /* int */ }",
    "pow": "RT_FN rt_float f(rt_float a) { return pow(a, a); }",
    "native_sqrt": "RT_FN rt_float f(rt_float a) { return native_sqrt(a); }",
    "fma by its bare name": "RT_FN rt_float f(rt_float a) { return fma(a, a, a); }",
    "min": "RT_FN rt_float f(rt_float a) { return min(a, a); }",
    "dot": "RT_FN rt_float f(rt_float a) { return dot(a, a); }",
    "an unheard-of builtin": "RT_FN rt_float f(rt_float a) { return nextafter(a, a); }",
    "float3": "RT_FN void f(void) { float3 a; }",
    "double": "RT_FN void f(void) { double a; }",
    "bool": "RT_FN void f(void) { bool a; }",
    "size_t": "RT_FN void f(void) { size_t a; }",
    "volatile": "RT_FN void f(void) { volatile rt_u32 a; }",
    "goto": "RT_FN void f(void) { goto end; end:; }",
    "literal without f": "RT_FN rt_float f(rt_float a) { return a - 1.0; }",
    "hex literal without f": "RT_FN rt_float f(rt_float a) { return a - 0x1.8p+1; }",
    "exponent literal without f": "RT_FN rt_float f(rt_float a) { return a - 1e3; }",
    "decimal literal that is no float": "RT_FN rt_float f(rt_float a) { return a - 0.1f; }",
    "hex literal with too many digits": "RT_FN rt_float f(rt_float a) { return a - 0x1.0000001p+1f; }",
    "target in #if": "#if defined(RT_TARGET_CUDA)\n#endif",
    "target in #ifdef": "#ifdef __OPENCL_VERSION__\n#endif",
    "target in #elif": "#if 0\n#elif defined(__CUDACC__)\n#endif",
    "foreign include": "#include <math.h>",
    "double literal in the fast rung": "#if RT_FAST(RT_FAST_ROOTS)\n#define F(a) ((a) - 1.0)\n#endif",
    "double literal in other rungs": "#if RT_PRECISION == RT_PRECISION_DOUBLE\n#else\n#define F(a) ((a) - 1.0)\n#endif",
    "approximation in a kernel": "#if RT_FAST(RT_FAST_ROOTS)\n#define F(a) native_sqrt(a)\n#endif",
    "compat: approximation in every rung": "#define F(a) native_sqrt(a)",
    "compat: approximation in the exact rung": "#if RT_FAST(RT_FAST_ROOTS)\n#else\n#define F(a) __sinf(a)\n#endif",
    "compat: approximation in the double rung":
        "#if RT_PRECISION == RT_PRECISION_DOUBLE\n#define F(a) native_recip(a)\n#endif",
    "compat: double in the exact rung": "#if RT_PRECISION == RT_PRECISION_DOUBLE\n#endif\ntypedef double rt_planted;",
    "host constant": "RT_FN rt_float f(rt_float a) { return a - RT_PLANTED_HOST_CONSTANT; }",
}
TEXT_CLEAN = {
    "integer product": "RT_FN rt_uint f(rt_uint a, rt_u32 b) { return a * b + 1u; }",
    "integer compound": "RT_FN rt_uint f(rt_uint a, rt_uint b) { a += b * a; return a; }",
    "integer fields": "typedef struct t { rt_u32 width; } t;\nRT_FN rt_u32 f(t a, rt_u32 y) { return y * a.width + 1u; }",
    "integer cast": "RT_FN rt_i64 f(rt_u32 a, rt_u32 b) { return (rt_i64)(rt_i32)a * 1048576 + (rt_i64)(rt_i32)b; }",
    "marker": "RT_FN rt_u32 f(rt_u32 a) { return g(a) * 3u + 1u; /* int */ }\n#define g(a) (a)",
    "on purpose": "RT_FN rt_float f(rt_float a) { return a * a + a; /* bare: a canary */ }",
    "power of two": "RT_FN rt_float f(rt_float a) { return a * 0.5f + 1.0f; }",
    "explicit fma": "RT_FN rt_float f(rt_float a, rt_float b) { return rt_fma(a, b, a) - b; }",
    "product alone": "RT_FN rt_float f(rt_float a, rt_float b) { return -a * (b + a) * b; }",
    "pointer parameter": "RT_FN void f(RT_PRIVATE rt_float* a, RT_PRIVATE rt_float* b) { *a = *b + 1.0f; }",
    "comment": "/* a * b + c, pow(), 1.0, float3 */",
    "double literal in the double rung":
        "#if RT_PRECISION == RT_PRECISION_DOUBLE\nRT_FN rt_float f(rt_float a) { return a - 0x1.8p+1; }\n#endif",
    "compat: approximation in the fast rung":
        "#if RT_FAST(RT_FAST_ROOTS) && defined(RT_TARGET_OPENCL)\n#define F(a) native_sqrt(a)\n#endif",
    "compat: double in the double rung": "#if RT_PRECISION == RT_PRECISION_DOUBLE\ntypedef double rt_planted;\n#endif",
    "field called min": "typedef struct u { rt_float min; } u;\nRT_FN rt_float f(u a) { return a.min; }",
}

COMPILED_PRELUDE = '#include "common/rt_compat.h"\ntypedef struct pair { rt_float x, y; } pair;\n'
COMPILED_KERNEL = """
RT_KERNEL(planted)(RT_GLOBAL float* out, RT_GLOBAL const float* in, rt_u32 n)
{
	rt_float a = in[0], b = in[1], c = in[2];
	%s
}
"""
COMPILED_FAULTS = {
    "in one expression": ("", "out[0] = a * b + c;"),
    "through a variable": ("", "rt_float t = a * b; out[0] = c - t;"),
    "through functions": ("RT_FN pair scale(pair p, rt_float s) { p.x = p.x * s; p.y = p.y * s; return p; }\n"
                          "RT_FN rt_float add(pair p) { return p.x + p.y; }\n",
                          "pair p; p.x = a; p.y = b; out[0] = add(scale(p, c));"),
    "through a selection": ("", "rt_float t = rt_sel(a < b, a * b, c); out[0] = t + b;"),
    "through a loop": ("", "rt_float t = a; for (rt_u32 i = 0u; i < n; ++i) { out[i] = t - b; t = t * in[i]; }"),
    "negated": ("", "rt_float t = -(a * b); out[0] = t + c;"),
    "double arithmetic": ("", "out[0] = (float)((double)a * 0.1 * (double)b);"),
    "library function": ("", "out[0] = std::sin(a);"),
}
DOUBLE_FAULTS = {
    "float arithmetic": ("", "float t = in[0] * in[1]; out[0] = t;"),
    "rounded to float": ("RT_FN float half(float x) { return x * 0.5f; }\n", "out[0] = half((float)(a * b));"),
    "product in a sum": ("RT_FN rt_float add(rt_float s, rt_float t) { return s + t; }\n",
                         "RT_GLOBAL double* o = reinterpret_cast<double*>(out); *o = add(a * b, c);"),
}
DOUBLE_CLEAN = {
    "float memory": ("", "RT_GLOBAL double* o = reinterpret_cast<double*>(out); *o = rt_fma(a, b, c) + 0.5f;"),
}
COMPILED_CLEAN = {
    "fma": ("", "out[0] = rt_fma(a, b, c) + a;"),
    "power of two": ("", "out[0] = a * 0x1p-24f + c;"),
    "on purpose": ("", "out[0] = a * b + c; /* bare */"),
    "integers": ("", "out[0] = rt_to_float(rt_to_int(rt_bits(a) * 3u + n));"),
    "product alone": ("", "out[0] = a * b; out[1] = (a + c) * b; out[2] = rt_fma(a, b, a * c);"),
}


def self_test(clang):
    failures, count = [], 0
    host = {"common/planted.h": "#define RT_PLANTED_HOST_CONSTANT 0x1p-30\n"}
    for cases, wanted in ((TEXT_FAULTS, True), (TEXT_CLEAN, False)):
        for name, code in cases.items():
            count += 1
            path = COMPAT if name.startswith("compat: ") else "kernels/planted.h"
            findings = check_text({**host, path: code})
            if bool(findings) != wanted:
                failures.append(f"text, {name}: {'not found' if wanted else findings[0]}")
    if clang:
        for cases, wanted, in_double in ((COMPILED_FAULTS, True, False), (COMPILED_CLEAN, False, False),
                                         (DOUBLE_FAULTS, True, True), (DOUBLE_CLEAN, False, True)):
            for name, (before, code) in cases.items():
                count += 1
                with tempfile.TemporaryDirectory() as work:
                    root = Path(work)
                    (root / "common").mkdir()
                    (root / "kernels").mkdir()
                    shutil.copy(ROOT / COMPAT, root / COMPAT)
                    (root / "kernels/planted.cl").write_text(COMPILED_PRELUDE + before + COMPILED_KERNEL % code)
                    defines = ["-DRT_PRECISION=2"] if in_double else []
                    text, _ = compile_host(clang, root, ["kernels/planted.cl"], defines)
                    findings = check_module(text, root, in_double)
                if bool(findings) != wanted:
                    failures.append(f"compiled{', in double' if in_double else ''}, {name}: {'not found' if wanted else findings[0]}")
    for failure in failures:
        print(f"self-test: {failure}")
    print(f"lint_kernels: self-test, {count - len(failures)} of {count} cases right")
    return 1 if failures else 0


def main():
    parser = argparse.ArgumentParser(description="Checks the shared kernel language (contract rules 2 and 3).")
    parser.add_argument("--self-test", action="store_true", help="check the lint on planted faults")
    parser.add_argument("--text-only", action="store_true", help="without clang++")
    arguments = parser.parse_args()
    clang = None if arguments.text_only else shutil.which("clang++")
    if not arguments.text_only and not clang:
        print("lint_kernels: clang++ is not here; --text-only does without", file=sys.stderr)
        return 2
    if arguments.self_test:
        return self_test(clang)

    paths = sorted([*(ROOT / "common").glob("*.h"), *(p for p in (ROOT / "kernels").glob("*") if p.is_file())])
    files = {str(p.relative_to(ROOT)): p.read_text() for p in paths}
    if not any(path.startswith("kernels/") for path in files):
        print("lint_kernels: no kernels", file=sys.stderr)
        return 2
    findings = check_text(files)
    variants = 0
    if clang:
        try:
            compiled, variants = check_compiled(clang, ROOT)
        except RuntimeError as error:
            print(f"lint_kernels: {error}", file=sys.stderr)
            return 2
        findings += compiled
    for finding in findings:
        print(finding)
    print(f"lint_kernels: {len(files)} files, {variants} compiled variants, {len(findings)} findings")
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
