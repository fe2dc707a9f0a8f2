"""What a refusal must look like; shared by the tests of bad input."""

import os
import re

from rhl.errors import InputError

# Longer than any key's description with what was found; a message is to be read in one breath.
_LONGEST = 600
_EXPECTS = re.compile(r"\bmust\b|is not a known key; expected")
# argparse's own sentences say both in one.
_CALL = re.compile(
    r"are required: |invalid choice: |unrecognized arguments: |expected one argument"
    r"|invalid \w+ value: |not allowed with|ignored explicit argument"
)


def faults(message, wanted, remedy=None):
    """Return what is wrong with a message: the empty list if it is one good sentence that says what is wanted."""
    found = []
    if "\n" in message or not message.isprintable():
        found.append("not one printable line")
    if "Traceback" in message:
        found.append("a traceback")
    if len(message) > _LONGEST:
        found.append(f"{len(message)} characters")
    if not (_EXPECTS.search(message) or _CALL.search(message)):
        found.append("does not say what is expected")
    if not (re.search(r"\bgot\b", message) or _CALL.search(message)):
        found.append("does not say what was found")
    if not re.search(wanted, message):
        found.append(f"does not match {wanted!r}")
    if remedy is not None and not re.search(rf"(; |, ){remedy}", message):
        found.append("does not say what to do")
    return found


def refusal(call, kind=InputError):
    """Call, and return the message of the error, which must be of exactly this kind."""
    result, raised = None, None
    try:
        result = call()
    except Exception as error:
        raised = error
    assert raised is not None, f"not refused: {result!r:.100}"
    assert type(raised) is kind, f"{type(raised).__name__} instead of {kind.__name__}: {raised}"
    return str(raised)


def listing(folder):
    """Every file below a folder with its content."""
    found = {}
    for root, _, names in os.walk(folder):
        if "__pycache__" in root:
            continue
        for name in names:
            path = os.path.join(root, name)
            if os.path.isfile(path):
                with open(path, "rb") as file:
                    found[os.path.relpath(path, folder)] = file.read()
    return found
