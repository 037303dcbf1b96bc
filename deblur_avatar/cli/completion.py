"""Print what completes the command line in a shell: subcommands, options, choices, files.

bash   deblur-avatar completion bash > ~/.local/share/bash-completion/completions/deblur-avatar
zsh    deblur-avatar completion zsh > <a folder of $fpath>/_deblur-avatar
fish   deblur-avatar completion fish > ~/.config/fish/completions/deblur-avatar.fish
"""

import argparse
import sys
from dataclasses import dataclass

from deblur_avatar.cli import main

PROGRAM = "deblur-avatar"
BASH = """\
_deblur_avatar() {{
  local word=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}} known=""
  if [ "$COMP_CWORD" -eq 1 ]; then known="{commands} --help --version"
  else
    case "${{COMP_WORDS[1]}} $before" in
{choices}
      *) case "${{COMP_WORDS[1]}}" in
{options}
      esac ;;
    esac
  fi
  COMPREPLY=($(compgen -W "$known" -- "$word"))
}}
complete -o default -F _deblur_avatar deblur-avatar
"""
# zsh loads the file as a function at the first Tab, which is to complete, too.
ZSH = """\
#compdef deblur-avatar
autoload -Uz bashcompinit && bashcompinit
{bash}[ "$funcstack[1]" = _deblur-avatar ] && _bash_complete -o default -F _deblur_avatar
"""


@dataclass(frozen=True)
class Option:
    """What can be typed after a subcommand."""

    name: str  # --name, or empty for words without one
    purpose: str
    choices: tuple[str, ...]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of the subcommand."""
    parser.add_argument("shell", choices=("bash", "fish", "zsh"))


def run(asked: argparse.Namespace) -> int:
    """Print the script; returns 0."""
    known = {name: options_of(name) for name in main.COMMANDS}
    script = {"bash": bash, "zsh": lambda k: ZSH.format(bash=bash(k)), "fish": fish}[asked.shell]
    sys.stdout.write(script(known))
    return 0


def options_of(command: str) -> list[Option]:
    """Options and choices of a subcommand, as its own parser has them."""
    parser = main.command_parser([command])
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    return [
        Option(
            name=max(action.option_strings, key=len, default=""),
            purpose=(action.help or "").partition("(")[0].partition(";")[0].strip(" ,"),
            choices=tuple(map(str, action.choices or ())),
        )
        for action in commands.choices[command]._actions
    ]


def bash(known: dict[str, list[Option]]) -> str:
    """A function for bash; files complete where nothing else does."""
    choices, options = [], []
    for command, found in known.items():
        for option in found:
            if option.name and option.choices:
                case = f'      "{command} {option.name}") known="{" ".join(option.choices)}" ;;'
                choices.append(case)
        words = [w for o in found for w in ([o.name] if o.name else o.choices)]
        options.append(f'        {command}) known="{" ".join(words)}" ;;')
    return BASH.format(
        commands=" ".join(known), choices="\n".join(choices), options="\n".join(options)
    )


def fish(known: dict[str, list[Option]]) -> str:
    """A line a word for fish, with what it means."""
    lines = []
    for command in known:
        purpose = main.COMMANDS[command].replace("'", "\\'")
        lines.append(f"-n __fish_use_subcommand -f -a {command} -d '{purpose}'")
    for command, found in known.items():
        for option in found:
            words = f"-n '__fish_seen_subcommand_from {command}'"
            if option.name:
                words += f" -l {option.name.removeprefix('--')}"
                words += " -x" if option.choices else ""
            elif not option.choices:
                continue
            if option.choices:
                words += f" -a '{' '.join(option.choices)}'"
            lines.append(words + " -d '{}'".format(option.purpose.replace("'", "\\'")))
    return "".join(f"complete -c {PROGRAM} {line}\n" for line in lines)
