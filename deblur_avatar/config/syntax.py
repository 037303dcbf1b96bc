"""Source as it is compared: what in a file can change a result, and nothing else.

- Python by its syntax tree, without docstrings, positions and what only a type checker runs;
- C++ by its tokens, without comments and white space;
- everything else (a page's template, a chart's specification) by its bytes.

A registry of kinds (`Registry` of config/kinds.py) counts without its kinds, which have hashes of
their own.
"""

import ast
import hashlib
import re
from functools import lru_cache

PACKAGES = ("deblur_avatar", "benchmarks")
PLACE = re.compile(rf"(?P<module>({'|'.join(PACKAGES)})(\.\w+)+):\w+")
BLOCKS = ("body", "orelse", "finalbody")  # statements of a node
CPP = (".cpp", ".cc", ".cu", ".cuh", ".h", ".hpp")
# In this order: what looks like a comment within a string is none.
CPP_TOKENS = re.compile(
    r"""(?P<raw>R"(?P<fence>[^()\\\s]{0,16})\(.*?\)(?P=fence)")
    | (?P<string>"(?:\\.|[^"\\\n])*")
    | (?P<comment>//[^\n]*|/\*.*?\*/)
    | (?P<number>\.?\d(?:[eEpP][+-]|'?[\w.])*)
    | (?P<character>'(?:\\.|[^'\\\n])*')
    | (?P<word>\w+)
    | (?P<mark><<=|>>=|<=>|\.\.\.|->\*|::|->|\+\+|--|<<|>>|&&|\|\||\#\#|[-+*/%&|^<>=!]=|[^\s\w])
    | (?P<space>\s+)""",
    re.DOTALL | re.VERBOSE,
)


@lru_cache(maxsize=1024)
def content_hash(suffix: str, content: bytes) -> str:
    """The hash of one file's content, as its kind is compared."""
    if suffix == ".py":
        content = _canonical(stripped(ast.parse(content))).encode()
    elif suffix in CPP:
        content = "\0".join(cpp_tokens(content.decode())).encode()
    return hashlib.sha256(content).hexdigest()


def _canonical(tree: ast.AST) -> str:
    """A syntax tree as text, the same for every Python that knows the syntax.

    `ast.dump` is not: versions add fields, and 3.13 leaves empty ones out. Here fields that are
    None or empty are left out always; how many follow is said, so that none can pass for another.
    """
    said: list[str] = []
    waiting: list[tuple[str, object]] = [("", tree)]
    while waiting:
        name, value = waiting.pop()
        if isinstance(value, ast.AST):
            fields = [
                (field, content)
                for field, content in ast.iter_fields(value)
                if field != "kind" and content is not None and content != []
            ]
            said.append(f"{name} {type(value).__name__} {len(fields)}")
            waiting += reversed(fields)
        elif isinstance(value, list):
            said.append(f"{name} of {len(value)}")
            waiting += [("", item) for item in reversed(value)]
        else:
            said.append(f"{name} {type(value).__name__} {value!a}")
    return "\n".join(said)


def cpp_tokens(text: str) -> list[str]:
    """What a C++ compiler reads: no comments, no white space but what a directive needs.

    Where a directive ends is a token, and so is the space by which `#define f (x)` differs from
    `#define f(x)`.
    """
    tokens: list[str] = []
    line: list[str] = []
    spaced = False
    for match in CPP_TOKENS.finditer(re.sub(r"\\\r?\n", "", text) + "\n"):
        if match.lastgroup in ("space", "comment"):
            spaced = True
            if "\n" in match[0] and match.lastgroup == "space":
                tokens += [*line, "\n"] if line[:1] == ["#"] else line
                line = []
        else:
            named = line[1:2] == ["define"] and len(line) == 3
            line += [" ", match[0]] if named and spaced and match[0] == "(" else [match[0]]
            spaced = False
    return tokens


def stripped(tree: ast.AST) -> ast.AST:
    """The tree without what does nothing: docstrings, other strings that stand by themselves, and
    what is under `if TYPE_CHECKING:`; without the kinds of a registry, whose hashes are their own;
    and with pieces of an f-string that follow each other as one.
    """
    for node in ast.walk(tree):
        for name in BLOCKS:
            block = getattr(node, name, None)
            if isinstance(block, list):
                setattr(node, name, [line for line in block if not _is_prose(line)])
        if isinstance(node, ast.If) and _last_name(node.test) == "TYPE_CHECKING":
            node.body = []
        if isinstance(node, ast.Dict) and places_of_kinds(node):
            node.keys, node.values = [], []
        if isinstance(node, ast.JoinedStr):
            node.values = _joined(node.values)
    return tree


def _is_prose(statement: ast.AST) -> bool:
    value = statement.value if isinstance(statement, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _last_name(node: ast.expr) -> str | None:
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", None)


def _joined(values: list[ast.expr]) -> list[ast.expr]:
    merged: list[ast.expr] = []
    for value in values:
        last = merged[-1] if merged else None
        if isinstance(value, ast.Constant) and isinstance(last, ast.Constant):
            merged[-1] = ast.Constant(str(last.value) + str(value.value))
        elif not (isinstance(value, ast.Constant) and value.value == ""):
            merged.append(value)
    return merged


def places_of_kinds(node: ast.AST) -> list[tuple[str, str]]:
    """The names and places of a dictionary of kinds."""
    if not isinstance(node, ast.Dict):
        return []
    return [
        (str(name.value), str(place.value))
        for name, place in zip(node.keys, node.values, strict=True)
        if isinstance(name, ast.Constant)
        and isinstance(place, ast.Constant)
        and PLACE.fullmatch(str(place.value))
    ]
