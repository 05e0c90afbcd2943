"""Reading XML from an untrusted source into the elements of a robot's kinematics: links and joints.

Sizes are bounded, nothing is fetched, and what is not plain XML is refused with file,
line, element and reason.

Source: the XML specification, w3.org/TR/xml; defusedxml for the attacks.
"""

import os
import re
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler

MAX_BYTES = 16 * 2**20
MAX_ELEMENTS = 100_000
MAX_DEPTH = 64
PIECE = 2**18
"""Characters that the parser is given at a time."""
XINCLUDE = "http://www.w3.org/2001/XInclude"
XACRO_DEFINES = ("property", "arg", "macro")
"""Elements of xacro that define something, and change nothing by themselves."""
_DECLARED = re.compile(r"<\?xml\s[^>]*?\bencoding\s*=\s*[\"']([^\"']*)")


class ArmFileError(ValueError):
    """A file that does not describe an arm: where, which element, and why."""


def show(text: str, most: int | None = 80) -> str:
    """Text that is safe to print: control characters escaped, long lines cut."""
    return repr(text if most is None or len(text) <= most else text[:most] + "...")[1:-1]


def quote(text: str) -> str:
    return '"' + show(text).replace('"', '\\"') + '"'


def listing(names: Iterable[str]) -> str:
    names = list(names)
    return ", ".join(names[:12]) + ", ..." * (len(names) > 12)


def file_error(file: str, line: int, label: str, reason: str) -> ArmFileError:
    # A path is not cut: its end says which file it is.
    place = show(file, None) + (f":{line}" if line else "")
    return ArmFileError(": ".join(part for part in (place, label, reason) if part))


class Element(NamedTuple):
    file: str
    line: int
    label: str
    """What messages call it: inside a link or joint, that link or joint."""
    tag: str
    attributes: dict[str, str]
    children: dict[str, "Element"]

    def error(self, reason: str) -> ArmFileError:
        return file_error(self.file, self.line, self.label, reason)

    def required(self, key: str) -> str:
        text = self.attributes.get(key)
        if not text:
            raise self.error(f"<{show(self.tag)}> needs a {key}")
        if is_xacro(text):
            raise self.error(f"{key} of <{show(self.tag)}> is {quote(text)}: expand xacro first")
        return text


def is_xacro(text: str) -> bool:
    """Whether an attribute holds what xacro would replace."""
    return "${" in text or "$(" in text


def load(source: Any) -> tuple[str, str]:
    """The file's name and its text, of whatever `Arm.from_urdf` takes."""
    if hasattr(source, "write_xml_string"):
        # A `yourdfpy.URDF`, which writes its numbers to the last digit, and ASCII.
        written = source.write_xml_string().partition(b"?>")[2]
        return "<yourdfpy.URDF>", _decode("<yourdfpy.URDF>", written)
    if isinstance(source, bytes):
        return "<string>", _decode("<string>", source)
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        # Half a surrogate pair passes here, and is refused with other broken UTF-8.
        return "<string>", _decode("<string>", source.encode("utf-8", "surrogatepass"))
    name = os.fsdecode(source)
    if name.endswith(".xacro"):
        return name, _decode(name, _expanded(name))
    with open(name, "rb") as file:
        return name, _decode(name, file.read(MAX_BYTES + 1))


def _expanded(file: str) -> bytes:
    """A xacro file as URDF, by the package xacro, which evaluates what it says: it must be trusted."""
    try:
        import xacro
    except ImportError:
        reason = "is xacro: pip install xacro, which evaluates the file, or expand it first"
        raise file_error(file, 0, "", reason) from None
    try:
        return xacro.process_file(file).toxml().encode()
    except xacro.XacroException as error:
        raise file_error(file, 0, "", f"xacro cannot expand it: {error}") from error


def _decode(file: str, data: bytes) -> str:
    if len(data) > MAX_BYTES:
        raise file_error(file, 0, "", f"the file is larger than {MAX_BYTES >> 20} MB")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise file_error(file, line, "", f"the file must be UTF-8, byte {error.start} is not") from None
    before, zero, _ = text.partition("\0")
    if zero:
        raise file_error(file, before.count("\n") + 1, "", "the file must be UTF-8 text, it holds a NUL byte")
    declared = _DECLARED.match(text)
    if declared and declared[1].lower() not in ("utf-8", "utf8"):
        raise file_error(file, 1, "", f"the file must be UTF-8, it says {quote(declared[1])}")
    return text


class _Collector(ContentHandler):
    """Collects links and joints from the parser's events, and counts all elements.

    It builds no deep tree that one would have to recurse into.
    """

    robot: Element
    space: str
    """The robot's namespace."""

    def __init__(self, file: str, line: Callable[[], int]):
        self.file, self.line, self.count = file, line, 0
        self.open: list[Element] = []
        self.named: dict[str, dict[str, Element]] = {"link": {}, "joint": {}}

    def startElement(self, tag: str, attrs) -> None:
        depth, attributes = len(self.open), dict(attrs.items())
        name = f" name={quote(attributes['name'])}" if "name" in attributes else ""
        label = self.open[1].label if depth > 1 else f"<{show(tag)}{name}>"
        element = Element(self.file, self.line(), label, tag, attributes, {})
        self.open.append(element)
        space = self._check(element)
        if depth == 0:
            self.robot, self.space = element, space
        elif space != self.space:
            pass  # of another namespace, which the kinematics do not use
        elif depth == 1 and tag in self.named:
            # A joint off the chain may have no name: its number is its key.
            nameless = tag == "joint" and not attributes.get("name")
            key = f"\0{self.count}" if nameless else element.required("name")
            self._add(self.named[tag], key, element)
        elif depth == 2 and self.open[1].tag == "joint":
            self._add(self.open[1].children, tag, element)

    def endElement(self, tag: str) -> None:
        self.open.pop()

    def _add(self, elements: dict[str, Element], key: str, element: Element) -> None:
        """Add an element under a key that no other has."""
        first = elements.setdefault(key, element)
        if first is not element:
            raise element.error(f"duplicate <{show(element.tag)}>, the first is on line {first.line}")

    def _check(self, element: Element) -> str:
        """The element's namespace; an element that is not allowed where it is raises."""
        self.count += 1
        if self.count > MAX_ELEMENTS:
            raise element.error(f"the file holds more than {MAX_ELEMENTS} elements")
        if len(self.open) > MAX_DEPTH:
            raise element.error(f"elements are nested deeper than {MAX_DEPTH}")
        prefix, colon, name = element.tag.rpartition(":")
        space = self._space("xmlns" + colon + prefix)
        if space == XINCLUDE or element.tag == "xi:include":
            raise element.error("XInclude is refused: nothing is fetched")
        # Old xacro files include others without a prefix.
        old = len(self.open) == 2 and element.tag == "include"
        xacro = prefix == "xacro" or space.endswith("/xacro")
        if old or (xacro and self._is_kinematic(name)):
            raise element.error(f"<{show(element.tag)}> is not URDF: expand xacro first")
        if len(self.open) == 1 and element.tag != "robot":
            raise element.error("the root element must be <robot>")
        return space

    def _is_kinematic(self, name: str) -> bool:
        """Whether an element of xacro may change links and joints.

        A definition does not, nor does what stands inside of one, or inside of anything but a joint.
        """
        robot_or_joint = len(self.open) <= 2 or self.open[1].tag == "joint"
        return robot_or_joint and (name not in XACRO_DEFINES or len(self.open) == 1)

    def _space(self, key: str) -> str:
        """The namespace that a prefix stands for here."""
        # Looked up here: a parser that resolves namespaces copies a long name for every attribute.
        return next((x.attributes[key] for x in reversed(self.open) if key in x.attributes), "")


def parse(file: str, text: str) -> tuple[Element, dict[str, Element], dict[str, Element]]:
    """The root element, the links and the joints."""
    try:
        from defusedxml.common import DefusedXmlException
        from defusedxml.expatreader import DefusedExpatParser
    except ImportError as error:
        raise ImportError('reading a URDF file needs defusedxml: pip install "ikjax[urdf]"') from error
    parser = DefusedExpatParser(forbid_dtd=True)
    collector = _Collector(file, parser.getLineNumber)
    parser.setContentHandler(collector)
    try:
        # In pieces, because after an error the parser still runs to the end of what it was given.
        for start in range(0, len(text) + 1, PIECE):
            parser.feed(text[start : start + PIECE])
        parser.close()
    except SAXParseException as error:
        label = collector.open[-1].label if collector.open else ""
        raise file_error(file, parser.getLineNumber(), label, f"broken XML: {error.getMessage()}") from None
    except DefusedXmlException:
        line = text.count("\n", 0, text.index("<!DOCTYPE")) + 1
        raise file_error(file, line, "", "a DTD, and entities with it, is refused") from None
    return collector.robot, collector.named["link"], collector.named["joint"]
