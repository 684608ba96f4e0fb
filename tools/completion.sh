# SPDX-License-Identifier: BSD-3-Clause
# source tools/completion.sh: bash and zsh then complete packages and executables of ./run.
[ -z "${ZSH_VERSION:-}" ] || { autoload -Uz compinit bashcompinit && compinit && bashcompinit; }

_piezo_run() {
    local word=${COMP_WORDS[COMP_CWORD]} found=()
    case $COMP_CWORD in
        1) found=($(cd "${COMP_WORDS[0]%/*}/install" 2>/dev/null && ls -d piezo_*/lib/piezo_* 2>/dev/null | sed 's,/.*,,')) ;;
        2) found=($(ls "${COMP_WORDS[0]%/*}/install/${COMP_WORDS[1]}/lib/${COMP_WORDS[1]}" 2>/dev/null)) ;;
    esac
    COMPREPLY=($(compgen -W "${found[*]}" -- "$word"))
}
complete -o default -F _piezo_run ./run
