"""A command line made from a dataclass: its fields are the options, the text below each field is the help.

Fields are str, int, float, Path, bool (a flag), Literal, ``X | None``, tuples of them (``--noise-mm 0 1``), tuples of
pairs (``--ranges-deg 0 30 30 60``), and dataclasses, whose options form a group of their own. A field without a default
is required. argparse parses; a bad command line raises ReorientError with one line of text.
"""

import argparse
import ast
import difflib
import inspect
import shutil
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass, replace
from itertools import pairwise, takewhile
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, NoReturn, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from reorient.errors import OutOfRange, ReorientError, in_short

T = TypeVar("T")
_POSITIONAL = object()
Positional = Annotated[T, _POSITIONAL]
"""``Positional[Path]``: a field given by its place, not by its name."""


@dataclass(frozen=True)
class Metavar:
    """``Annotated[float, Metavar("M")]``: the words for the values in the help; default: by unit and type."""

    words: str | tuple[str, ...]


@dataclass(frozen=True)
class Presets:
    """``Annotated[Config, Presets(PRESETS)]``: a positional argument chooses the values that options then change."""

    values: Mapping[str, Any]

    @property
    def kind(self) -> Any:
        """The type of a name."""
        return Literal.__getitem__(tuple(self.values))


_UNITS = {"m": "M", "mm": "MM", "deg": "DEG", "px": "PX", "s": "S", "nm": "NM"}
_TYPES = {int: "N", float: "X", Path: "PATH", str: "NAME"}
_NUMBERS: dict[type, str] = {int: "a whole number", float: "a number"}
_LARGEST_WIDTH = 110  # of the help, characters


def parse(config: type[T], program: str, arguments: Sequence[str]) -> T:
    """An object of the dataclass. Raises ReorientError for a bad command line; ``--help`` prints and exits with 0."""
    parser = make_parser(config, program)
    if {"-h", "--help"} & set(arguments):
        print(parser.format_help(), end="")  # argparse's own printing hides a closed pipe
        raise SystemExit(0)
    words = [f" {word}" if _is_negative(word) else word for word in arguments]  # not an option to argparse: -1e-3
    if wrong := _wrong_option(words, {option.flag: option for option in _flat(config) if not option.positional}):
        parser.error(wrong)
    given, extra = parser.parse_known_intermixed_args(words)
    if extra:
        parser.error(_unexpected(extra[0], words))
    try:
        return cast(T, _build(config, {name: value for name, value in vars(given).items() if value is not None}))
    except OutOfRange as error:
        raise ReorientError(
            f"--{error.name.replace('_', '-')} {_in_words(error.value)}: expected {error.expected}"
        ) from error


def make_parser(config: type, program: str) -> argparse.ArgumentParser:
    """The parser of a dataclass; ``program`` is the command that it follows, such as ``reorient estimate``."""
    width = min(shutil.get_terminal_size().columns, _LARGEST_WIDTH)
    text, _, examples = (inspect.getdoc(config) or "").partition("\n\nExamples:\n")
    places = [f.metavar if f.default is MISSING else f"[{f.metavar}]" for f in _flat(config) if f.positional]
    parser = _Parser(
        program,
        " ".join([program, *places, "[options]"]),
        "\n\n".join(textwrap.fill(_plain(paragraph), width) for paragraph in text.split("\n\n")),
        f"examples:\n{textwrap.indent(textwrap.dedent(examples), '  ')}" if examples else None,
        formatter_class=lambda prog: argparse.RawDescriptionHelpFormatter(prog, max_help_position=30, width=width),
        add_help=False,
        allow_abbrev=False,
        argument_default=argparse.SUPPRESS,
    )
    positionals, options = parser.add_argument_group("arguments"), parser.add_argument_group("options")
    groups: dict[str, Any] = {"": options}
    for option in _flat(config):
        if option.group not in groups:
            title, _, description = option.group.partition(".")
            title = title[0].lower() + title[1:]
            groups[option.group] = parser.add_argument_group(title, _plain(" ".join(description.split())) or None)
        option.add_to(positionals if option.positional else groups[option.group])
    options.add_argument("--traceback", action="store_true", help="Show where an error arose.")
    options.add_argument("-h", "--help", action="help", help="Show this help and exit.")
    return parser


class _Parser(argparse.ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ReorientError(f"{message} (see {self.prog} --help)")


@dataclass(frozen=True)
class _Option:
    """One field of a dataclass as an argument of the command line."""

    name: str
    kind: Any
    """Type of the field, without ``| None``."""
    markers: tuple[Any, ...]
    """What its annotation adds to the type."""
    default: Any
    """MISSING where the field is required."""
    text: str
    """The string below it."""
    group: str = ""
    """Docstring of the dataclass within that has the field; "" for one of the verb's own."""

    @property
    def flag(self) -> str:
        """The option's name."""
        return "--" + self.name.replace("_", "-")

    @property
    def positional(self) -> bool:
        """Whether it is given by its place."""
        return _POSITIONAL in self.markers

    @property
    def metavar(self) -> Any:
        """The word for the value, or a tuple of words where there are several."""
        if words := self.marked(Metavar):
            return words.words
        if self.positional:
            return self.name.upper()
        if get_origin(self.kind) is Literal:
            return f"{{{','.join(get_args(self.kind))}}}"
        return _UNITS.get(self.name.rsplit("_", 1)[-1]) or _TYPES[_item(self.kind)]

    def marked(self, kind: type[T]) -> T | None:
        """The marker of this class, if there is one."""
        return next((marker for marker in self.markers if isinstance(marker, kind)), None)

    def add_to(self, group: Any) -> None:
        """Add it to a group of an argparse parser."""
        keywords: dict[str, Any] = {"help": self.help.replace("%", "%%")}
        if self.kind is bool:
            group.add_argument(self.flag, dest=self.name, action="store_true", **keywords)
            return
        keywords |= {"metavar": self.metavar, "type": _converter(_item(self.kind))}
        if get_origin(self.kind) is tuple:
            args = get_args(self.kind)
            keywords["nargs"] = "+" if args[-1] is Ellipsis else len(args)
        if self.positional:
            optional = {} if self.default is MISSING else {"nargs": "?", "default": None}
            group.add_argument(self.name, **keywords | optional)
        else:
            group.add_argument(self.flag, dest=self.name, required=self.default is MISSING, **keywords)

    def converted(self, value: Any) -> Any:
        """What argparse made of the option as its type has it: one value, a tuple, or a tuple of pairs."""
        if get_origin(self.kind) is not tuple:
            return value
        if get_origin(get_args(self.kind)[0]) is not tuple:
            return tuple(value)
        if len(value) % 2:
            raise ReorientError(f"argument {self.flag}: expected an even number of values, not {len(value)}")
        return tuple(zip(value[::2], value[1::2], strict=True))

    @property
    def help(self) -> str:
        """The text below the field, and the default."""
        silent = self.default is MISSING or self.default is None or self.default is False or self.default == ()
        return _plain(self.text) + ("" if silent else f" (default: {_in_words(self.default)})")


def _options(config: type, start: Any = None) -> Iterator[_Option]:
    """The fields of a dataclass; ``start``: an object whose values are the defaults, None: those of the class."""
    hints, texts = get_type_hints(config, include_extras=True), _texts(config)
    for each in fields(config):
        kind, *markers = get_args(hint) if get_origin(hint := hints[each.name]) is Annotated else (hint,)
        if get_origin(kind) in (Union, UnionType):
            (kind,) = [arg for arg in get_args(kind) if arg is not NoneType]
        own = each.default if each.default_factory is MISSING else each.default_factory()
        default = own if start is None else getattr(start, each.name)
        yield _Option(each.name, kind, tuple(markers), default, texts.get(each.name, ""))


def _flat(config: type, start: Any = None, group: str = "") -> Iterator[_Option]:
    """The options of a dataclass, with those of the dataclasses within it in their place."""
    for option in _options(config, start):
        if not is_dataclass(option.kind):
            yield replace(option, group=group)
            continue
        inner = _flat(cast(type, option.kind), option.default, inspect.getdoc(option.kind) or option.name)
        if presets := option.marked(Presets):
            first = next(name for name, value in presets.values.items() if value == option.default)
            yield replace(option, kind=presets.kind, markers=(_POSITIONAL,), default=first)
            inner = (replace(each, default=None) for each in inner)  # the defaults are those of the preset
        yield from inner


def _build(config: type, given: dict[str, Any], start: Any = None) -> Any:
    """The object with the given values; the others are those of ``start``, or of the class."""
    values = {}
    for option in _options(config, start):
        if is_dataclass(option.kind):
            presets = option.marked(Presets)
            inner = presets.values[given[option.name]] if presets and option.name in given else option.default
            values[option.name] = _build(cast(type, option.kind), given, inner)
        elif option.name in given:
            values[option.name] = option.converted(given[option.name])
    return config(**values) if start is None else replace(start, **values)


def _texts(config: type) -> dict[str, str]:
    """The string below each field of a dataclass, inherited ones too, on one line."""
    inherited = _texts(config.__base__) if config.__base__ and is_dataclass(config.__base__) else {}
    (node,) = ast.parse(textwrap.dedent(inspect.getsource(config))).body
    return inherited | {
        field.target.id: " ".join(text.value.value.split())
        for field, text in pairwise(node.body)  # type: ignore[attr-defined]
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }


def _plain(text: str) -> str:
    return text.replace("``", "'")  # no markup


def _in_words(value: Any) -> str:
    """A value as it is typed: a tuple, of pairs too, as words."""
    if isinstance(value, tuple):
        return " ".join(map(_in_words, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _is_negative(word: str) -> bool:
    """Whether a word is a number with a minus."""
    try:
        return word.startswith("-") and isinstance(float(word), float)
    except ValueError:
        return False


def _item(kind: Any) -> Any:
    """The type of a single value of a tuple, of pairs too; else the type itself."""
    while get_origin(kind) is tuple:
        kind = get_args(kind)[0]
    return kind


def _converter(kind: Any) -> Callable[[str], Any]:
    """From a word of the command line to a value; a wrong word raises what argparse reports."""

    def convert(word: str) -> Any:
        if get_origin(kind) is Literal:
            if word not in get_args(kind):
                raise argparse.ArgumentTypeError(f"expected one of {', '.join(get_args(kind))}, not {in_short(word)!r}")
            return word
        try:
            return kind(word)
        except ValueError as error:
            expected = _NUMBERS.get(kind, "a value")
            raise argparse.ArgumentTypeError(f"expected {expected}, not {in_short(word.strip())!r}") from error

    return convert


def _wrong_option(words: list[str], options: Mapping[str, _Option]) -> str:
    """The message for the first option that is unknown or has too few of a fixed number of values; "" for none."""
    for place, word in enumerate(words):
        name = word.partition("=")[0]
        if not word.startswith("-") or word == "-":
            continue
        if name not in options:
            return f"unknown option {in_short(name)!r}{did_you_mean(name, list(options))}"
        args = get_args(options[name].kind) if get_origin(options[name].kind) is tuple else ()
        given = len(list(takewhile(lambda each: each == "-" or not each.startswith("-"), words[place + 1 :])))
        if args and args[-1] is not Ellipsis and given < len(args) and name == word:
            return f"argument {name}: expected {len(args)} numbers, got {given}"
    return ""


def _unexpected(word: str, words: list[str]) -> str:
    """The message for a word that the parser could not place."""
    before = [each for each in words[: words.index(word)] if each.startswith("--")]
    return f"unexpected argument {in_short(word.strip())!r}" + (f" after {in_short(before[-1])}" if before else "")


def did_you_mean(name: str, known: Sequence[str]) -> str:
    """The end of a message about an unknown name: the nearest known one, or nothing."""
    near = difflib.get_close_matches(name[:200], known, n=1, cutoff=0.7)
    return f": did you mean {near[0]!r}?" if near else ""
