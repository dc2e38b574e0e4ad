/* Shell completion of one command (core/options/options_completion.h). bash and zsh share the
 * branches, which set `flags`, `values` and `files`. Head and tail differ.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/options/options_completion.h"

#include <string.h>

static const char *const completion_always[] = {"config", "print-config", "help", "help=all"};
enum { COMPLETION_ALWAYS = sizeof completion_always / sizeof *completion_always };

static bool completion_takes_files(const struct options_def *d)
{
    return d->type == OPTIONS_TEXT && (!strcmp(d->unit, "FILE") || !strcmp(d->unit, "DIR") ||
                                       !strcmp(d->unit, "CITY.tiles") || !strcmp(d->unit, "CITY"));
}

/* "none|2d|mip" with blanks for the bars. */
static void completion_choices(FILE *f, const char *choices)
{
    for (const char *p = choices; *p; p++)
        putc(*p == '|' ? ' ' : *p, f);
}

static void completion_branch(FILE *f, const struct options_spec *spec)
{
    fprintf(f, "    %s)\n        flags='", spec->command);
    for (size_t i = 0; i < spec->n_defs; i++) {
        char flag[OPTIONS_NAME_MAX + 4];
        if (spec->defs[i].type == OPTIONS_GROUP)
            continue;
        options_help_shown_flag(&spec->defs[i], flag);
        fprintf(f, "--%s ", flag);
    }
    for (size_t i = 0; i < COMPLETION_ALWAYS; i++)
        fprintf(f, "--%s ", completion_always[i]);
    fprintf(f, "-v -q -h'\n        case $prev in\n        -o | --config) kind=files ;;\n");
    for (size_t i = 0; i < spec->n_defs; i++) {
        const struct options_def *d = &spec->defs[i];
        char flag[OPTIONS_NAME_MAX];
        if (d->type == OPTIONS_GROUP || d->type == OPTIONS_BOOL)
            continue;
        options_help_flag(d->key, flag);
        fprintf(f, "        --%s) ", flag);
        if (d->type == OPTIONS_ENUM) {
            fprintf(f, "kind=values values='");
            completion_choices(f, d->unit);
            fprintf(f, "' ;;\n");
        } else {
            fprintf(f, "kind=%s ;;\n", completion_takes_files(d) ? "files" : "nothing");
        }
    }
    fprintf(f, "        esac\n        ;;\n");
}

/* Help between single quotes of fish: backslash and quote are escaped. */
static void completion_fish_text(FILE *f, const char *text)
{
    for (; *text; text++) {
        if (*text == '\\' || *text == '\'')
            putc('\\', f);
        putc(*text, f);
    }
}

static void completion_fish(FILE *f, const struct options_spec *spec)
{
    for (size_t i = 0; i < spec->n_defs; i++) {
        const struct options_def *d = &spec->defs[i];
        char flag[OPTIONS_NAME_MAX + 4];
        if (d->type == OPTIONS_GROUP)
            continue;
        options_help_shown_flag(d, flag);
        fprintf(f, "complete -c citysplat -n '__fish_seen_subcommand_from %s' -l %s", spec->command,
                flag);
        if (d->type == OPTIONS_ENUM) {
            fprintf(f, " -x -a '");
            completion_choices(f, d->unit);
            putc('\'', f);
        } else if (d->type != OPTIONS_BOOL) {
            fputs(completion_takes_files(d) ? " -r -F" : " -x", f);
        }
        fprintf(f, " -d '");
        completion_fish_text(f, d->help);
        fprintf(f, "'\n");
    }
}

void options_completion_print(FILE *f, const struct options_spec *spec, enum options_format format)
{
    if (format == OPTIONS_FORMAT_FISH)
        completion_fish(f, spec);
    else
        completion_branch(f, spec);
}

void options_completion_head(FILE *f, const char *const *names, size_t n,
                             enum options_format format)
{
    static const char before[] = "    local flags='' values='' kind=flags command=";
    if (format == OPTIONS_FORMAT_BASH)
        fprintf(f,
                "# bash completion of citysplat; `citysplat completion bash` prints it.\n"
                "_citysplat()\n{\n    local cur=${COMP_WORDS[COMP_CWORD]} "
                "prev=${COMP_WORDS[COMP_CWORD - 1]}\n%s${COMP_WORDS[1]}\n"
                "    [ \"$COMP_CWORD\" -gt 1 ] || command=''\n",
                before);
    else if (format == OPTIONS_FORMAT_ZSH)
        fprintf(f,
                "#compdef citysplat\n# `citysplat completion zsh` prints this.\n"
                "_citysplat() {\n    local cur=${words[CURRENT]} prev=${words[CURRENT-1]}\n"
                "%s${words[2]}\n    (( CURRENT > 2 )) || command=''\n",
                before);
    else
        fprintf(f, "# fish completion of citysplat; `citysplat completion fish` prints it.\n");
    if (format == OPTIONS_FORMAT_FISH) {
        fprintf(f, "complete -c citysplat -n __fish_use_subcommand -f -a 'help completion");
        for (size_t i = 0; i < n; i++)
            fprintf(f, " %s", names[i]);
        fprintf(f, "'\n");
        return;
    }
    fprintf(f, "    case $command in\n    '' | help)\n        kind=values values='help completion");
    for (size_t i = 0; i < n; i++)
        fprintf(f, " %s", names[i]);
    fprintf(f, "'\n        ;;\n    completion)\n        kind=values values='bash zsh fish'\n"
               "        ;;\n");
}

void options_completion_tail(FILE *f, enum options_format format)
{
    if (format == OPTIONS_FORMAT_BASH)
        fprintf(f, "    esac\n"
                   "    case $kind in\n"
                   "    flags)\n"
                   "        if [ \"${cur#-}\" != \"$cur\" ]; then\n"
                   "            mapfile -t COMPREPLY < <(compgen -W \"$flags\" -- \"$cur\")\n"
                   "        else\n"
                   "            mapfile -t COMPREPLY < <(compgen -f -- \"$cur\")\n"
                   "        fi\n"
                   "        ;;\n"
                   "    values) mapfile -t COMPREPLY < <(compgen -W \"$values\" -- \"$cur\") ;;\n"
                   "    files) mapfile -t COMPREPLY < <(compgen -f -- \"$cur\") ;;\n"
                   "    *) COMPREPLY=() ;;\n"
                   "    esac\n"
                   "}\n"
                   "complete -o filenames -F _citysplat citysplat\n");
    else if (format == OPTIONS_FORMAT_ZSH)
        fprintf(f, "    esac\n"
                   "    case $kind in\n"
                   "    flags)\n"
                   "        if [[ $cur == -* ]]; then\n"
                   "            compadd -- ${=flags}\n"
                   "        else\n"
                   "            _files\n"
                   "        fi\n"
                   "        ;;\n"
                   "    values) compadd -- ${=values} ;;\n"
                   "    files) _files ;;\n"
                   "    esac\n"
                   "}\n"
                   "_citysplat \"$@\"\n");
}
