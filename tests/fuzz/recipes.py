"""Hostile files that chance would hardly find: bombs, false sizes, and orders to run something.

Everything that would run leaves a trace in the audit log (`__main__.py`): it writes a file, or
calls a command. Sizes that are claimed are terabytes.
"""

import builtins
import io
import json
import os
import pickle
import struct
import zipfile
import zlib
from collections.abc import Iterator
from fractions import Fraction
from functools import cache

import av
import numpy as np

TERABYTES = 10**13
CANARY = "echo executed > canary"


def recipes(suffix: str, good: bytes) -> Iterator[bytes]:
    """Hostile files of one kind; those that any reader may be given come first."""
    yield from (b"", b"\0" * 1000, b"\xff\xfe", b"x", b"[" * 100_000, _run(os.system, CANARY))
    if suffix in PICKLES:
        yield from _programs()
    yield from {
        ".json": _json, ".yaml": _yaml, ".txt": _xml, ".toml": _toml, ".bvh": _bvh, ".npz": _npz,
        ".npy": _npy, ".safetensors": _safetensors, ".mp4": _films, ".mkv": _films,
    }.get(suffix, _pictures if suffix in PICTURES else _nothing)(good)  # fmt: skip


PICKLES = (".pkl", ".npy", ".npz")
PICTURES = (".png", ".jpg", ".tif", ".bmp", ".webp", ".exr")


def _nothing(good: bytes) -> Iterator[bytes]:
    yield from ()


# --- text ---------------------------------------------------------------------------------------


def _json(good: bytes) -> Iterator[bytes]:
    text = good.decode()
    yield from (
        b"{}",
        b"[]",
        b"null",
        b"NaN",
        b"1e999",
        b"9" * 5000,
        good.decode().encode("utf-16"),
    )
    for key in ("seconds", "images", "people", "image_id", "camera", "frame", "keypoints"):
        for value in (
            "NaN",
            "1e999",
            "10000000000000",
            "-1",
            "[[[]]]",
            '"\\ud800"',
            '"9"',
            "9" * 5000,
        ):
            if f'"{key}"' in text:
                yield text.replace(f'"{key}": ', f'"{key}": {value}, "_": ', 1).encode()
    yield b'{"people": [' + b'{"pose_keypoints_2d": [' + b"1e38," * 74 + b"1]}]}"


def _yaml(good: bytes) -> Iterator[bytes]:
    yield from (
        b"a: &a [*a]", b"&a {a: *a}", b"a: &a\n  <<: *a", b"a: 2001-13-45", b"a: !!int ''",
        b"a: !!python/object/apply:os.system ['" + CANARY.encode() + b"']", b"%YAML 9.9\n---\na: 1",
        b"!!python/object/new:os.system ['x']", b"a: !!bool maybe", b"? [1]\n: 1", b"? {a: 1}\n: 1",
        b"a: !!binary '*'", b"a: !!set {x}", b"a: !!omap [x: 1]", b"- - - - 1", b"a: 1\na: 2",
        b"shared: params.yaml", b"shared: below.yaml", b'shared: "\\0"', b"shared: .", b"shared: 1",
        b"---\na: 1\n---\nb: 2", b"{" * 2000, b"- " * 2000, b"a: b\n" * 100_000, b"a: \xff",
        b"runs: [1]\nseed: 0", b"seed: 0\n? null\n: 1", b'"\\ud800": 1\nseed: 0', b"a: 1e999",
    )  # fmt: skip


def _xml(good: bytes) -> Iterator[bytes]:
    laughs = "".join(f'<!ENTITY x{i} "{f"&x{i - 1};" * 10}">' for i in range(1, 12))
    bomb = f'<!DOCTYPE a [<!ENTITY x0 "ha">{laughs}]>'.encode()
    yield b"<?xml version='1.0'?>" + bomb + b"<a>&x11;</a>"
    outside = b'<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]>'
    yield outside + b'<a><camera serial="1">&x;</camera></a>'
    for name in (
        b"foo",
        b"utf-7",
        b"utf-16",
        b"idna",
        b"rot13",
        b"zlib",
        b"punycode",
        b"\xff",
        b"ebcdic",
    ):
        yield good.replace(b'version="1.0"', b'version="1.0" encoding="' + name + b'"')
    yield b"<a>" * 200_000
    yield good.replace(b'right="1087"', b'right="1e308" left="-1e308"').replace(
        b' left="0"', b"", 1
    )
    for size in (b"1e308", b"1e30", b"-5", b"inf", b"nan", b"1_0", b"1e18"):
        yield good.replace(b'right="1087"', b'right="' + size + b'"')
        yield good.replace(b'focalLengthU="89600"', b'focalLengthU="' + size + b'"')
        yield good.replace(b'x="2000.0"', b'x="' + size + b'"')
        yield good.replace(b'radialDistortion1="-0.04"', b'radialDistortion1="' + size + b'"')


def _toml(good: bytes) -> Iterator[bytes]:
    yield b"a = " + b"[" * 5000
    yield b"a = " + b"{a = " * 5000
    yield b".".join([b"a"] * 20_000) + b" = 1"
    yield b"[" + b".".join([b"a"] * 20_000) + b"]"
    for value in (
        b"9" * 5000,
        b"9" * 400,
        b"2001-01-01",
        b"inf",
        b"nan",
        b"1e308",
        b"'x'",
        b"true",
        b"-5.0",
        b"0",
    ):
        for old in (b"1088.0", b"1400.0", b"542.0", b"-0.05", b"1.2", b"4.2"):
            yield good.replace(old, value)
    yield good.replace(b"size", b"fisheye = true\nsize", 1)
    yield good.replace(b"[cam_1]", b"[[cam_1]]")
    yield good.replace(b"[ 1088.0, 1920.0]", b"[" * 400 + b"1" + b"]" * 400)


def _bvh(good: bytes) -> Iterator[bytes]:
    text = good.decode()
    for frames in (str(TERABYTES), "9" * 5000, "\u00b2", "\u0663", "-1", "0", "1e9", "3.0"):
        yield text.replace("Frames: 3", f"Frames: {frames}").encode()
    for step in ("5e-324", "1e-310", "1e308", "inf", "nan", "-1", "0"):
        yield text.replace("0.0333", step).encode()
    for place in ("1e300", "1e39", "nan", "0x1", "1_0"):
        yield text.replace("OFFSET 15 5 0", f"OFFSET {place} 5 0").encode()
        yield text.replace("0.5 0.5 0.5", f"{place} 0.5 0.5").encode()
    end = "End Site\n{\nOFFSET 0 1 0\n}\n"
    many = f"HIERARCHY\nROOT a\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n{end * 20_000}}}\n"
    yield (many + "MOTION\nFrames: 20000\nFrame Time: 0.01\n" + "0\n" * 20_000).encode()
    deep = "".join(f"JOINT j{i}\n{{\nOFFSET 0 1 0\n" for i in range(3000))
    root = f"HIERARCHY\nROOT a\n{{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n{deep}{end}"
    yield (root + "}\n" * 3001 + "MOTION\nFrames: 1\nFrame Time: 0.01\n0\n").encode()


# --- arrays -------------------------------------------------------------------------------------


def _header(shape: str, dtype: str = "<f8") -> bytes:
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text


def _npz(good: bytes) -> Iterator[bytes]:
    with zipfile.ZipFile(io.BytesIO(good)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    for name in members:
        for content in (
            _header(f"({TERABYTES},)"), _header(f"({TERABYTES}, 72)"), _header("(-1,)"), b"raw",
            _header("(100000000,)"), _header("(0, 9999999999999999999)"), _header("((((1,),),),)"),
            _header("(1,)", "|O") + _run(os.system, CANARY), _header("(3,)", "<U9999999"), b"",
        ):  # fmt: skip
            yield _zip({**members, name: content})
        yield _zip(
            {key: value for key, value in members.items() if key != name}
            | {name.removesuffix(".npy"): members[name]}
        )
        yield _zip(
            {key: value for key, value in members.items() if key != name}
            | {name.removesuffix(".npy"): b"raw"}
        )
        first = name.encode()
        place = good.rfind(b"PK\x01\x02", 0, good.rfind(first))
        claimed = bytearray(good)
        claimed[place + 20 : place + 28] = b"\xfe\xff\xff\x7f" * 2
        yield bytes(claimed)
        method = bytearray(good)
        method[place + 10] = 14  # LZMA
        yield bytes(method)
        encrypted = bytearray(good)
        encrypted[place + 8] |= 1
        yield bytes(encrypted)
    yield _zip({"../../outside.npy": b"x", "/etc/x": b"y", **members})
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    yield stream.getvalue()


def _zip(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    return stream.getvalue()


def _npy(good: bytes) -> Iterator[bytes]:
    for shape in (
        f"({TERABYTES},)",
        "(100000000,)",
        "(-1,)",
        "(0, 9999999999999999999)",
        "(True,)",
    ):
        yield _header(shape) + b"\0" * 24
    yield _header("(" * 150 + "1" + ")" * 150)
    yield _header("(2,)", "<U3") + b"a\0\0\0" * 6
    yield _header("(24, 3)", "<c16") + b"\0" * 1152
    for program in _programs():
        yield _header("()", "|O") + program
    for value in ("text", ["a"], 1.5, None, np.zeros(3), {"cams": 1, "ims": []}):
        yield _header("()", "|O") + pickle.dumps(value)


# --- pickles ------------------------------------------------------------------------------------


class _Call:
    """Pickles as a call."""

    def __init__(self, function: object, *arguments: object) -> None:
        self.call = function, arguments

    def __reduce__(self) -> tuple[object, tuple[object, ...]]:
        return self.call


def _run(function: object, *arguments: object) -> bytes:
    return pickle.dumps({"poses": _Call(function, *arguments)}, 2)


def _key(name: bytes, value: bytes) -> bytes:
    """A dictionary of one entry, in the language of pickles."""
    return b"\x80\x04}X" + struct.pack("<I", len(name)) + name + value + b"s."


def _global(module: str, name: str) -> bytes:
    return f"c{module}\n{name}\n".encode()


def _programs() -> Iterator[bytes]:
    """Pickles that want to run something, to allocate much, or to break what reads them."""
    yield _run(os.system, CANARY)
    yield _run(builtins.eval, "open('canary', 'w')")
    yield _run(builtins.exec, "open('canary', 'w')")
    yield _run(builtins.open, "canary", "w")
    yield _run(np.save, "canary.npy", np.zeros(1))
    yield b"(S'" + CANARY.encode() + b"'\nios\nsystem\n."
    yield b"\x80\x02cos\nsystem\n(S'" + CANARY.encode() + b"'\no."
    yield b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93\x8c\x011\x85R."
    yield b"\x80\x02cnumpy\nndarray\n(K\x01\x85tR."
    yield from (
        b"\x80\x02\x82\x01.",
        b"Pid\n.",
        b"\x80\x02K\x01Q.",
        b"\x80\x02.",
        b"\x80\x02R.",
        b"\x80\x02(.",
    )
    size = struct.pack("<Q", TERABYTES)
    yield from (
        b"\x80\x04\x8e" + size,
        b"\x80\x04\x8d" + size,
        b"\x80\x04\x95" + size,
        b"\x80\x05\x96" + size,
    )
    yield from (
        b"\x80\x02\x8b\xff\xff\xff\x7f",
        b"\x80\x04B\xff\xff\xff\x7f",
        b"\x80\x02r\xff\xff\xff\x7f",
    )
    yield b"\x80\x04\x8e" + struct.pack("<Q", 2**31)
    # A tuple in a tuple, a million deep: to hash it is to run out of stack.
    yield b"\x80\x04}" + b")" + b"\x85" * 1_000_000 + b"K\x01s."
    yield b"\x80\x04}(" + b")" + b"\x85" * 100_000 + b"K\x01u."
    yield b"\x80\x04" + b"]" * 100_000 + b"a" * 99_999 + b"."
    # Each in the next one three times: to hash or to print the last one takes for ever.
    tuples = b"K\x01\x94" + b"".join(b"h%c" % i * 3 + b"\x87\x94" for i in range(40))
    lists = b"]\x94" + b"".join(b"](" + b"h%c" % i * 3 + b"e\x94" for i in range(40))
    yield b"\x80\x04" + tuples + b"}h\x28K\x01s."
    yield b"\x80\x04" + tuples + b"(h\x28\x91."
    yield b"\x80\x04" + lists + b"Q."
    for call in (b"cbuiltins\nbytes\n", b"cnumpy\ndtype\n", b"ctorch._utils\n_rebuild_tensor_v2\n"):
        yield b"\x80\x04" + lists + call + b"h\x28\x85R."
    yield _key(b"cams", b")" + b"\x85" * 5000)
    laughs = b"](K\x01K\x01e\x94" + b"".join(
        b"](" + b"h" + bytes([i]) * 1 + (b"h" + bytes([i])) * 9 + b"e\x94" for i in range(40)
    )
    for name in (b"poses", b"cams", b"smpl_poses", b"v_template", b"Rh"):
        yield _key(name, laughs)
        yield _key(name, b"]\x94(h\x00h\x00e")  # a list that holds itself
    dtype = _global("numpy", "dtype")
    wrong = b"\x8c\x02V8\x89\x88\x87R"
    array = (
        _global("numpy._core.multiarray", "_reconstruct")
        + _global("numpy", "ndarray")
        + b"K\x00\x85C\x01b\x87R"
    )
    objects = dtype + b"\x8c\x02O8\x89\x88\x87R"
    states = (
        b"(K\x03\x8c\x01|NNNJ\xff\xff\xff\x7fK\x01K\x00t",
        b"(K\x03\x8c\x01<NNNJ\x00\x00\x00\x01J\x00\x00\x00\x01K\x00t",
        b"(K\x03\x8c\x01|N\x8c\x01a\x85}\x8c\x01a" + objects
        + b"J\xff\xff\xff\x7f\x86sK\x08K\x01K\x10t",
        b"(K\x03\x8c\x01|" + objects + b"J\xff\xff\x00\x00\x85\x86NNK\x08K\x01K?t",
        b"(K\x03\x8c\x01|NNNK\x08K\x01K?t", b"(t", b"N", b"(K\x09\x8c\x01?NNNK\x00K\x00K\x00t",
    )  # fmt: skip
    for name in (b"smpl_poses", b"cams", b"v_template"):
        for state in states:
            for code in (
                wrong,
                b"\x8c\x02f8\x89\x88\x87R",
                b"\x8c\x02O8\x89\x88\x87R",
                b"\x8c\x03f8,\x89\x88\x87R",
            ):
                made = dtype + code + state + b"b"
                yield _key(name, array + b"(K\x01K\x01\x85" + made + b"\x89C\x08AAAAAAAAtb")
                yield _key(
                    name, _global("numpy._core.multiarray", "scalar") + made + b"C\x08AAAAAAAA\x86R"
                )
        big = b"\x8a\x06" + TERABYTES.to_bytes(6, "little")
        code = dtype + b"\x8c\x02f8\x89\x88\x87R"
        yield _key(name, array + b"(K\x01" + big + b"\x85" + code + b"\x89C\x08AAAAAAAAtb")
        yield _key(name, dtype + b"\x8c\x0bV2000000000\x89\x88\x87R")
        yield _key(name, dtype + b"\x8c\x10(100000000,999)f8\x89\x88\x87R")
        for inside in (b"(X\x01\x00\x00\x00xKt", b"}(X\x04\x00\x00\x00dataK\x01ub", b"Nb", b"}b"):
            for kind in (
                "scipy.sparse._csc\ncsc_matrix",
                "chumpy.ch\nCh",
                "chumpy.reordering\nSelect",
            ):
                yield _key(name, b"c" + kind.encode() + b"\n)\x81" + inside)
    yield b"\x80\x02}" + b"".join(b"cchumpy\nk%d\n0" % i for i in range(100_000)) + b"."
    yield (
        b"\x80\x02"
        + b"]" * 10
        + b"cbuiltins\nbytes\n\x8a\x06"
        + TERABYTES.to_bytes(6, "little")
        + b"\x85R."
    )
    yield b"\x80\x02cbuiltins\nfrozenset\n" + b")" + b"\x85" * 50_000 + b"\x85R."


# --- tensors ------------------------------------------------------------------------------------


def _entry(name: str, kind: str, count: int, size: int) -> str:
    return json.dumps({name: {"dtype": kind, "shape": [count], "data_offsets": [0, size]}})


def _safetensors(good: bytes) -> Iterator[bytes]:
    for size in (TERABYTES, 2**64 - 1, 100_000_001, 0, 1):
        yield struct.pack("<Q", size) + good[8:]
    yield struct.pack("<Q", TERABYTES)
    headers = (
        _entry("a", "F32", TERABYTES, 4 * TERABYTES),
        '{"a":{"dtype":"F32","shape":[0,9223372036854775807],"data_offsets":[0,0]}}',
        '{"a":{"dtype":"F32","shape":[0,9223372036854775807,9],"data_offsets":[0,0]}}',
        '{"a":{"dtype":"F32","shape":[4294967296,4294967296],"data_offsets":[0,0]}}',
        '{"a":{"dtype":"F32","shape":[-1],"data_offsets":[0,4]}}', "[" * 1000, "{}", "[]", "1",
        *(
            _entry(name, kind, 4, 4 * size)
            for name in (
                "networks", "networks.a", "tensors.a", "tensors", "parents", "names", "frames"
            )
            for kind, size in (("F8_E4M3", 1), ("F8_E8M0", 1), ("C64", 8), ("BOOL", 1), ("U16", 2))
        ),
        '{"a":{"dtype":"F4","shape":[8],"data_offsets":[0,4]}}',
    )  # fmt: skip
    for header in headers:
        yield struct.pack("<Q", len(header)) + header.encode() + b"\0" * 64


# --- pictures and films -------------------------------------------------------------------------


def _chunk(kind: bytes, content: bytes) -> bytes:
    check = struct.pack(">I", zlib.crc32(kind + content))
    return struct.pack(">I", len(content)) + kind + content + check


def png(width: int, height: int, bits: int = 8, colour: int = 2, *more: bytes) -> bytes:
    """A sound PNG file of little content that says it is of any size."""
    head = struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, 0)
    body = _chunk(b"IDAT", zlib.compress(b"\0" * 1000))
    return (
        b"\x89PNG\r\n\x1a\n" + _chunk(b"IHDR", head) + b"".join(more) + body + _chunk(b"IEND", b"")
    )


@cache
def _zeros() -> bytes:
    """50 MB of nothing, compressed: a third of a second."""
    return zlib.compress(b"\0" * 50_000_000)


def _pictures(good: bytes) -> Iterator[bytes]:
    for side in (0, 20_000, 60_000, 2**31 - 1):
        yield png(side, side)
        yield png(side, 1)
        yield png(1, side)
    yield png(8, 6, 16, 2)
    yield png(8, 6, 8, 2, _chunk(b"zTXt", b"a\0\0" + _zeros()))
    yield png(8, 6, 8, 2, _chunk(b"iCCP", b"a\0\0" + _zeros()))
    yield png(
        8,
        6,
        8,
        2,
        _chunk(b"eXIf", b"MM\0*\0\0\0\x08\xff\xff" + b"\x01\x12\0\3\xff\xff\xff\xff\0\0\0\0" * 9),
    )
    yield (
        b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 6\n%%EndComments\n"
        b"(canary) (w) file closefile showpage\n%%EOF\n"
    )
    yield b"P6 60000 60000 255\n" + b"\0" * 100
    yield b"P6 8 6 255\n" + b"\0" * 144
    yield b"GIF89a\xff\xff\xff\xff\0\0\0,\0\0\0\0\xff\xff\xff\xff\0\x02\x02D\x01\0;"
    yield b"BM" + struct.pack(
        "<IHHIIiiHHIIiiII", 200, 0, 0, 54, 40, 60_000, -60_000, 1, 24, 0, 0, 0, 0, 0, 0
    )
    yield b"\xff\xd8\xff\xc0\0\x11\x08\xff\xff\xff\xff\x03\x01\x11\0\x02\x11\0\x03\x11\0\xff\xda"
    for count in (1, 65_000):
        entries = [
            (256, 4, 1, 60_000),
            (257, 4, 1, 60_000),
            (258, 3, 1, 8),
            (259, 3, 1, 1),
            (262, 3, 1, 1),
            (273, 4, count, 8),
            (277, 3, 1, 1),
            (279, 4, count, 8),
        ]
        table = b"".join(struct.pack("<HHII", *entry) for entry in entries)
        yield b"II*\0\x08\0\0\0" + struct.pack("<H", len(entries)) + table + b"\0" * 4
    window = b"dataWindow\0box2i\0\x10\0\0\0"
    if window in good:
        start = good.index(window) + len(window)
        for corners in ((0, 0, 2**31 - 1, 2**31 - 1), (-(2**31), 0, 9, 9), (0, 0, 9_999, 9_999)):
            yield good[:start] + struct.pack("<iiii", *corners) + good[start + 16 :]
    loop = struct.pack("<H", 1) + struct.pack("<HHII", 34665, 4, 1, 8) + struct.pack("<I", 8)
    yield b"II*\0\x08\0\0\0" + loop


def _films(good: bytes) -> Iterator[bytes]:
    here = b"film.mp4", b"film.mkv", b"other.mp4"
    for name in (*here, b"file:///etc/passwd", b"http://127.0.0.1:9/x.ts"):
        yield b"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n" + name + b"\n#EXT-X-ENDLIST\n"
        yield b"ffconcat version 1.0\nfile '" + name + b"'\n"
        yield (
            b"v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\n"
            b"m=video 9 RTP/AVP 96\na=rtpmap:96 H264/90000\n"
        )
    for side in (60_000, 16_000, 0, 1):
        yield b"YUV4MPEG2 W%d H%d F25:1 C420\nFRAME\n" % (side, side) + b"\0" * 100
    yield png(60_000, 60_000)
    yield png(20_000, 20_000)
    yield b"P6 20000 20000 255\n" + b"\0" * 1000
    yield b"GIF89a\x08\0\x06\0\0\0\0,\0\0\0\0\x08\0\x06\0\0\x02\x02D\x01\0;"
    yield b"RIFF\x24\0\0\0WAVEfmt \x10\0\0\0\1\0\1\0\x40\x1f\0\0\x40\x1f\0\0\1\0\x08\0data\0\0\0\0"
    yield b"1\n00:00:00,000 --> 00:00:01,000\nhello\n"
    yield good.replace(b"28", b"\xff\xfe").replace(b"focal", b"f\xe9cal")
    yield good.replace(b"avc1", b"zzz1").replace(b"V_MPEG4/ISO/AVC", b"V_MPEG9/ISO/AVC")
    yield _tall(2, 6000)


def _tall(width: int, height: int) -> bytes:
    stream = io.BytesIO()
    with av.open(stream, "w", format="avi") as container:
        video = container.add_stream("mpeg4", rate=Fraction(25))
        video.width, video.height, video.pix_fmt = width, height, "yuv420p"
        for value in (10, 200):
            image = np.full((height, width, 3), value, np.uint8)
            container.mux(video.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(video.encode())
    return stream.getvalue()
