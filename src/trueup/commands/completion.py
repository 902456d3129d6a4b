# SPDX-License-Identifier: Apache-2.0
"""`trueup completion`: a script that completes commands, options and file names in a shell."""

from __future__ import annotations

import argparse

from rich.console import Console

ABOUT = """\
Prints what completes commands, options and file names in a shell; nothing is installed.

  eval "$(trueup completion bash)"                                    in ~/.bashrc
  eval "$(trueup completion zsh)"                                     in ~/.zshrc
  trueup completion fish > ~/.config/fish/completions/trueup.fish
"""

_BASH = """\
_trueup() {{
  local word="${{COMP_WORDS[COMP_CWORD]}}" command="${{COMP_WORDS[1]}}" words=""
  if [ "$COMP_CWORD" = 1 ]; then words="{commands}"; else
    case "$word" in -*) case "$command" in
{cases}
    esac;; esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -o bashdefault -F _trueup trueup
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What this command takes."""
    parser.add_argument("shell", choices=("bash", "zsh", "fish"))


def run(args: argparse.Namespace, console: Console, told: Console) -> int:
    """Prints the script. Returns the exit code."""
    console.out(script(args.shell, args.words), highlight=False, end="")
    return 0


def script(shell: str, words: dict[str, list[tuple[str, str]]]) -> str:
    """The script for a shell; `words` are commands ('' for all) with (option, help)."""
    if shell == "fish":
        lines = [f"complete -c trueup -n __fish_use_subcommand -a {c} -d '{_plain(h)}'" for c, h in words[""]]
        lines += [
            f"complete -c trueup -n '__fish_seen_subcommand_from {c}' -l {o[2:]} -d '{_plain(h)}'"
            for c, options in words.items() if c for o, h in options
        ]  # fmt: skip
        return "\n".join(lines) + "\n"
    cases = "\n".join(f'      {c}) words="{" ".join(o for o, _ in options)}";;' for c, options in words.items() if c)
    bash = _BASH.format(commands=" ".join(c for c, _ in words[""]), cases=cases)
    return ("autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else "") + bash


def _plain(text: str) -> str:
    return text.replace("'", "").replace("%%", "%")[:80]
