"""`ikjax completion`: scripts that complete commands, options and names of arms in a shell.

Everything is read from the parser. Where an arm or a file is wanted, files are completed too.
"""

import argparse
import re

from ikjax.arm import robots
from ikjax.cli.output import print_result

SHELLS = ("bash", "zsh", "fish")

BASH = """\
_ikjax() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" words
    if [ "$COMP_CWORD" -eq 1 ]; then
        words="{commands}"
    else
        case "${{COMP_WORDS[1]}}" in
{cases}
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
    if [ "$COMP_CWORD" -gt 1 ]; then COMPREPLY+=($(compgen -f -- "$word")); fi
}}
complete -o filenames -F _ikjax ikjax
"""


def run_completion(options) -> int:
    from ikjax.cli.parser import build_parser

    words = words_of(build_parser())
    if options.shell == "fish":
        lines = []
        for name, (text, listed) in words.items():
            lines.append(f"complete -c ikjax -n __fish_use_subcommand -a {name} -d '{text}'")
            lines.append(f"complete -c ikjax -n '__fish_seen_subcommand_from {name}' -a '{' '.join(listed)}'")
        script = "\n".join(lines)
    else:
        cases = "\n".join(
            f'            {name}) words="{" ".join(listed)}" ;;' for name, (_, listed) in words.items()
        )
        script = BASH.format(commands=" ".join(words), cases=cases)
        if options.shell == "zsh":
            script = (
                f"autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n{script}"
            )
    print_result(options, script.rstrip(), {"commands": {name: each for name, (_, each) in words.items()}})
    return 0


def words_of(parser: argparse.ArgumentParser) -> dict[str, tuple[str, list[str]]]:
    """Each command with its help and the words that may follow it: options, choices and names of arms."""
    actions = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    commands = next(actions).choices
    found: dict[str, tuple[str, list[str]]] = {}
    for name, command in commands.items():
        words = [
            flag for action in command._actions for flag in action.option_strings if flag.startswith("--")
        ]
        for action in command._actions:
            if action.option_strings:
                continue
            if action.choices:
                words += map(str, action.choices)
            elif action.dest == "arm":
                words += robots.names()
        found[name] = re.sub(r"[^\w ,.]", "", str(command.description)), words
    return found
