"""Scripts for bash, zsh and fish from the grammar of the command line. No verb and no option is named here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Final

from fsai_vcu.cli.grammar import Kind, Option, Value, Verb

_ANYWHERE: Final = ("--help", "--version")
_HEADER: Final = "# Completion of fsai-vcu for {shell}, made by `fsai-vcu completion {shell}`: not to be edited.\n"

# What the shells call "every CAN interface of this machine" (linux/if_arp.h: a type of 280 is CAN).
_INTERFACES_SH: Final = """\
    local device
    for device in /sys/class/net/*; do
        [[ -r $device/type && $(<"$device/type") == 280 ]] && printf '%s\\n' "${device##*/}"
    done
"""

_BASH: Final = """\
# COMP_WORDS breaks words at = and : too, so they are taken from the line: blanks part them, quotes hold them together.
_fsai_vcu_split() {
    local char quote="" begun=0 place
    for ((place = 0; place < ${#line}; place++)); do
        char="${line:place:1}"
        if [[ $char == "\\\\" && $quote != "'" ]]; then
            place=$((place + 1))
            cur+="${line:place:1}"
            begun=1
        elif [[ -n $quote && $char == "$quote" ]]; then
            quote=""
        elif [[ -n $quote ]]; then
            cur+="$char"
        elif [[ $char == "'" || $char == '"' ]]; then
            quote="$char"
            begun=1
        elif [[ $char == [[:space:]] ]]; then
            [[ $begun == 1 ]] && words+=("$cur")
            cur=""
            begun=0
        else
            cur+="$char"
            begun=1
        fi
    done
}

_fsai_vcu() {
    COMPREPLY=()
    local line="${COMP_LINE:0:COMP_POINT}" cur="" path="" last="" word kind place=0 skip=0 ended=0
    local -a words=()
    _fsai_vcu_split
    for word in "${words[@]:1}"; do
        if [[ $skip == 1 ]]; then
            skip=0
        elif [[ $ended == 0 && $word == -- ]]; then
            ended=1
        elif [[ $ended == 0 && $word == -?* ]]; then
            if [[ $word != *=* ]] && _fsai_vcu_value "$path" "$word" > /dev/null; then
                skip=1
                last="$word"
            fi
        elif _fsai_vcu_verb "$path${path:+ }$word"; then
            path="$path${path:+ }$word"
            place=0
        else
            place=$((place + 1))
        fi
    done
    if [[ $skip == 1 ]]; then
        kind="$(_fsai_vcu_value "$path" "$last")"
        _fsai_vcu_offer "$kind" "$cur" ""
    elif [[ $ended == 0 && $cur == --*=* ]]; then
        kind="$(_fsai_vcu_value "$path" "${cur%%=*}")"
        _fsai_vcu_offer "$kind" "${cur#*=}" "${cur%%=*}="
    elif [[ $ended == 0 && $cur == -* ]]; then
        _fsai_vcu_offer "words $(_fsai_vcu_options "$path")" "$cur" ""
    else
        kind="$(_fsai_vcu_positional "$path" "$place")"
        _fsai_vcu_offer "$kind" "$cur" ""
    fi
}

_fsai_vcu_offer() {
    local kind="$1" cur="$2" before="$3" reply
    local -a found=()
    case "$kind" in
        words\\ *) mapfile -t found < <(compgen -W "${kind#words }" -- "$cur") ;;
        file) mapfile -t found < <(compgen -f -- "$cur"); compopt -o filenames 2> /dev/null ;;
        folder) mapfile -t found < <(compgen -d -- "$cur"); compopt -o filenames 2> /dev/null ;;
        interface) mapfile -t found < <(compgen -W "$(_fsai_vcu_interfaces)" -- "$cur") ;;
        source)
            mapfile -t found < <(compgen -W "$(_fsai_vcu_interfaces)" -- "$cur"; compgen -f -- "$cur")
            compopt -o filenames 2> /dev/null
            ;;
    esac
    # Readline replaces only what stands behind the last break of the word.
    local shown="$before$cur" whole
    for reply in "${found[@]}"; do
        whole="$before$reply"
        if [[ $shown == *=* && $COMP_WORDBREAKS == *=* ]]; then
            whole="${whole#"${shown%=*}="}"
        elif [[ $shown == *:* && $COMP_WORDBREAKS == *:* ]]; then
            whole="${whole#"${shown%:*}:"}"
        fi
        COMPREPLY+=("$whole")
    done
}
"""


def bash(verbs: Sequence[Verb]) -> str:
    """For bash 4 and newer, without any library of functions."""
    top = [verb for verb in verbs if " " not in verb.words]
    names = " ".join(verb.words for verb in top)
    parts = [
        _HEADER.format(shell="bash"),
        _bash_function(
            "_fsai_vcu_verb", _case("$1", [("|".join(_quoted(v.words) for v in verbs), "return 0")], "return 1")
        ),
        _bash_function(
            "_fsai_vcu_options",
            _case(
                "$1",
                [('""', f"echo {_quoted(' '.join(_ANYWHERE))}")]
                + [(_quoted(v.words), f"echo {_quoted(' '.join(_spellings(v.options)))}") for v in verbs],
            ),
        ),
        _bash_function(
            "_fsai_vcu_value",
            _case(
                "$1 $2",
                [
                    ("|".join(_quoted(f"{v.words} {name}") for name in option.names), _said(option.value))
                    for v in verbs
                    for option in v.options
                    if option.value is not None
                ],
                "return 1",
            ),
        ),
        _bash_function(
            "_fsai_vcu_positional",
            _case("$1 $2", [('" 0"', f"echo {_quoted(f'words {names}')}"), *_bash_positionals(verbs)]),
        ),
        f"_fsai_vcu_interfaces() {{\n{_INTERFACES_SH}}}\n",
        _BASH,
        "complete -F _fsai_vcu fsai-vcu\n",
    ]
    return "\n".join(parts)


def _bash_positionals(verbs: Sequence[Verb]) -> Iterable[tuple[str, str]]:
    for verb in verbs:
        if verb.subverbs:
            yield _quoted(f"{verb.words} 0"), f"echo {_quoted('words ' + ' '.join(verb.subverbs))}"
            continue
        for place, positional in enumerate(verb.positionals):
            pattern = f'"{verb.words} "*' if positional.value.many else _quoted(f"{verb.words} {place}")
            yield pattern, _said(positional.value)


def _said(value: Value) -> str:
    return f"echo {_quoted(' '.join((value.kind.value, *value.words)))}"


def _bash_function(name: str, body: str) -> str:
    return f"{name}() {{\n{body}}}\n"


def _case(of: str, branches: Iterable[tuple[str, str]], otherwise: str | None = None) -> str:
    lines = [f'    case "{of}" in']
    lines += [f"        {pattern}) {command} ;;" for pattern, command in branches]
    if otherwise is not None:
        lines.append(f"        *) {otherwise} ;;")
    return "\n".join([*lines, "    esac"]) + "\n"


# ---------------------------------------------------------------- zsh


def zsh(verbs: Sequence[Verb]) -> str:
    """For zsh's own completion system, as an autoloaded function or evaluated."""
    top = [verb for verb in verbs if " " not in verb.words]
    lines = [
        "#compdef fsai-vcu",
        _HEADER.format(shell="zsh"),
        "_fsai_vcu_interfaces() {",
        "    local -a found",
        "    local device",
        "    for device in /sys/class/net/*(N); do",
        '        [[ -r $device/type && "$(<$device/type)" == 280 ]] && found+=(${device:t})',
        "    done",
        "    compadd -a found",
        "}",
        "",
        "_fsai_vcu_sources() {",
        "    _fsai_vcu_interfaces",
        "    _files",
        "}",
        "",
    ]
    for verb in verbs:
        lines += _zsh_verb(verb, verbs)
    lines += ["_fsai_vcu() {", *_zsh_choice("fsai-vcu", "verb", top, "_fsai_vcu"), "}", ""]
    lines += [
        "if [[ $funcstack[1] == _fsai-vcu ]]; then",
        '    _fsai_vcu "$@"',
        "else",
        "    compdef _fsai_vcu fsai-vcu",
        "fi",
    ]
    return "\n".join(lines) + "\n"


def _zsh_verb(verb: Verb, verbs: Sequence[Verb]) -> list[str]:
    name = f"_fsai_vcu__{re.sub(r'[^A-Za-z0-9]', '_', verb.words)}"
    if verb.subverbs:
        below = [each for each in verbs if each.words in {f"{verb.words} {sub}" for sub in verb.subverbs}]
        return [f"{name}() {{", *_zsh_choice(verb.words, "verb", below, name), "}", ""]
    specs = [spec for option in verb.options for spec in _zsh_option(option)]
    for place, positional in enumerate(verb.positionals, 1):
        value = positional.value
        head = "*" if value.many else f"{place}" if value.required else f"{place}:"
        specs.append(_quoted(f"{head}:{_zsh_text(value.metavar)}:{_zsh_action(value)}"))
    return [
        f"{name}() {{",
        "    _arguments -s -S \\",
        *[f"        {spec} \\" for spec in specs],
        "        && return",
        "}",
        "",
    ]


def _zsh_choice(of: str, what: str, below: Sequence[Verb], function: str) -> list[str]:
    described = [_quoted(f"{verb.words.rpartition(' ')[2]}:{verb.summary}") for verb in below]
    cases = [
        f"                {_quoted(verb.words.rpartition(' ')[2])}) "
        f"_fsai_vcu__{re.sub(r'[^A-Za-z0-9]', '_', verb.words)} ;;"
        for verb in below
    ]
    return [
        "    local context state line curcontext=$curcontext",
        "    local -a choices",
        f"    choices=({' '.join(described)})",
        f"    _arguments -C '1: :->{what}' '*:: :->rest'",
        "    case $state in",
        f"        {what}) _describe {_quoted(f'{of} verb')} choices ;;",
        "        rest)",
        "            case $line[1] in",
        *cases,
        "            esac ;;",
        "    esac",
    ]


def _zsh_option(option: Option) -> Iterable[str]:
    said = _zsh_text(option.help)
    for name in option.names:
        if option.value is None:
            yield _quoted(f"*{name}[{said}]")
        else:
            assigned = "=" if name.startswith("--") else "+"
            yield _quoted(f"*{name}{assigned}[{said}]:{_zsh_text(option.value.metavar)}:{_zsh_action(option.value)}")


def _zsh_action(value: Value) -> str:
    return {
        Kind.NOTHING: " ",
        Kind.WORDS: f"({' '.join(value.words)})",
        Kind.FILE: "_files",
        Kind.FOLDER: "_files -/",
        Kind.INTERFACE: "_fsai_vcu_interfaces",
        Kind.SOURCE: "_fsai_vcu_sources",
    }[value.kind]


def _zsh_text(text: str) -> str:
    return re.sub(r"([\[\]:\\])", r"\\\1", text)


# ---------------------------------------------------------------- fish


def fish(verbs: Sequence[Verb]) -> str:
    """For fish 3 and newer."""
    top = [verb for verb in verbs if " " not in verb.words]
    lines = [
        _HEADER.format(shell="fish"),
        "function __fsai_vcu_interfaces",
        "    for device in /sys/class/net/*",
        "        test -r $device/type; and test (cat $device/type) = 280; and basename $device",
        "    end",
        "end",
        "",
        "complete -c fsai-vcu -f",
    ]
    none = "not __fish_seen_subcommand_from " + " ".join(verb.words for verb in top)
    lines += [f"complete -c fsai-vcu -n {_quoted(none)} -l {name[2:]}" for name in _ANYWHERE]
    for verb in top:
        lines.append(f"complete -c fsai-vcu -n {_quoted(none)} -a {_quoted(verb.words)} -d {_fish(verb.summary)}")
    for verb in verbs:
        words = verb.words.split()
        when = "; and ".join(f"__fish_seen_subcommand_from {word}" for word in words)
        for sub in verb.subverbs:
            others = " ".join(verb.subverbs)
            summary = next(each.summary for each in verbs if each.words == f"{verb.words} {sub}")
            condition = _quoted(f"{when}; and not __fish_seen_subcommand_from {others}")
            lines.append(f"complete -c fsai-vcu -n {condition} -a {_quoted(sub)} -d {_fish(summary)}")
        for option in verb.options:
            spelt = " ".join(f"-l {name[2:]}" if name.startswith("--") else f"-s {name[1:]}" for name in option.names)
            value = f" -r{_fish_value(option.value)}" if option.value is not None else ""
            lines.append(f"complete -c fsai-vcu -n {_quoted(when)} {spelt}{value} -d {_fish(option.help)}")
        for positional in verb.positionals:
            offered = _fish_value(positional.value)
            if offered:
                lines.append(f"complete -c fsai-vcu -n {_quoted(when)}{offered} -d {_fish(positional.help)}")
    return "\n".join(lines) + "\n"


def _fish_value(value: Value) -> str:
    return {
        Kind.NOTHING: "",
        Kind.WORDS: f" -f -a {_quoted(' '.join(value.words))}",
        Kind.FILE: " -F",
        Kind.FOLDER: " -f -a '(__fish_complete_directories)'",
        Kind.INTERFACE: " -f -a '(__fsai_vcu_interfaces)'",
        Kind.SOURCE: " -F -a '(__fsai_vcu_interfaces)'",
    }[value.kind]


def _fish(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


# ---------------------------------------------------------------- words


def _spellings(options: Iterable[Option]) -> list[str]:
    return [name for option in options for name in option.names]


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"
