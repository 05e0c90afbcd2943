"""`ikjax study`: write a commented study file, or list what may stand in one."""

import json
import pathlib

from ikjax.cli import study_file, whole_arm
from ikjax.cli.output import print_result
from ikjax.maps import statistics


def run_study(options) -> int:
    if options.action == "keys":
        print_result(options, study_file.MANUAL.rstrip(), {"keys": study_file.KEYS})
        return 0
    if options.action == "statistics":
        words = str(statistics.__doc__).partition("\n\n")[2].rstrip()
        print_result(options, words, {"statistics": statistics.available(redundant=True)})
        return 0
    whole_arm.find_arm(options.arm)  # raises where there is none
    # A JSON string is a TOML string.
    text = study_file.NEW.format(
        arm=json.dumps(options.arm), file="study.toml" if options.file == "-" else options.file
    )
    if options.file == "-":
        print(text, end="")
        return 0
    path = pathlib.Path(options.file)
    if path.suffix.lower() != ".toml":
        raise ValueError(f"the name of a study file ends in .toml, got {options.file}")
    if path.exists() and not options.force:
        raise ValueError(f"{path} is there already; --force replaces it")
    path.write_text(text, encoding="utf-8")
    print_result(options, f"wrote {path}; run it: ikjax sweep {path}", {"file": str(path)})
    return 0
