/* citysplat: drone photographs in, a city of Gaussians that a web map can stream out.
 *
 * Finds the command and runs it. stdout is data, stderr is the log. cli/base/outcome.c makes text
 * and exit code of an error.
 *
 *   citysplat help [COMMAND]          the commands, or one of them
 *   citysplat help --markdown         the command reference, docs/commands.md
 *   citysplat help --man [COMMAND]    a manual page in mdoc; the build makes and installs them
 *   citysplat completion SHELL        the completion of bash, zsh or fish; likewise
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <locale.h>
#include <stdio.h>
#include <string.h>

#include "cli/base/cli.h"
#include "cli/base/outcome.h"
#include "cli/base/output.h"
#include "core/options/options_completion.h"
#include "core/options/options_help.h"
#include "server/drawing/draw.h"

struct command {
    const char *name, *about;
    enum err_code (*run)(int argc, char **argv, struct err *e);
};

static const struct command commands[] = {
#define COMMAND(name, about) {#name, about, cli_##name},
#define COMMAND_AS(function, name, about) {name, about, cli_##function},
#include "cli/base/commands.def"
#undef COMMAND_AS
#undef COMMAND
    {NULL, NULL, NULL},
};

static const struct command *command_find(const char *name)
{
    for (const struct command *c = commands; c->name; c++)
        if (!strcmp(c->name, name))
            return c;
    return NULL;
}

static const char about_text[] =
    "drone photographs to a city of 3D Gaussians that any web map can stream";
static const char usual_way[] =
    "citysplat ingest photos/ photos/sparse/0 -o scene   # poses + GPS -> metres, east-north-up\n"
    "citysplat train scene                               # Gaussians at three levels of detail\n"
    "citysplat tile scene -o city.tiles                  # z/x/y pyramid in one file\n"
    "citysplat serve city.tiles                          # open http://127.0.0.1:8080/\n";

static void print_help(FILE *f)
{
    fprintf(f,
            "citysplat " CITYSPLAT_VERSION " - %s\n\n"
            "usage: citysplat COMMAND [arguments] [--options]\n\ncommands:\n",
            about_text);
    for (const struct command *c = commands; c->name; c++)
        fprintf(f, "  %-10s %s\n", c->name, c->about);
    fprintf(f,
            "\n`citysplat help COMMAND` shows its everyday options, `citysplat COMMAND --help=all` "
            "all of them.\n`citysplat completion bash|zsh|fish` prints a completion for the shell."
            "\n\nThe usual way:\n");
    for (const char *p = usual_way; *p; p += strcspn(p, "\n") + 1)
        fprintf(f, "  %.*s\n", (int)strcspn(p, "\n"), p);
}

/* last: nothing is printed after it. */
static int run(const struct command *c, int argc, char **argv, bool last)
{
    struct err e = {0};
    enum err_code rc = c->run(argc, argv, &e);
    if (!rc && last)
        rc = output_flush(&e);
    return outcome_tell(c->name, rc, &e, argc, argv);
}

/* ---- reference ---- */

/* The help of one command, printed by itself; `form` is "--help" or "--help=FORMAT". */
static int help_of(const struct command *c, const char *form)
{
    char name[32], flag[32];
    snprintf(name, sizeof name, "%s", c->name);
    snprintf(flag, sizeof flag, "%s", form);
    char *argv[] = {name, flag, NULL};
    return run(c, 2, argv, false);
}

static int print_markdown(void)
{
    printf("# Commands\n\nEvery command and every option, as `citysplat COMMAND --help=all` prints "
           "them. `citysplat\nhelp COMMAND` prints only the options of the tier everyday. This "
           "page is written by `citysplat help\n--markdown`; do not edit it.\n\nWhole numbers take "
           "`k`, `M` and `G`. These are thousands, or steps of 1024 where the unit is bytes. A "
           "list is\n`A,B,C`, coarsest level first; in config files also `[A, B, C]`.\n\nResults "
           "go to stdout and log lines to stderr. Exit codes: 0 done, 1 failed, 2 the command line "
           "was wrong. serve has others, in its own section.\n\nEvery command also takes `--config "
           "FILE` (options from a .jsonc file, with `_` for `-` in their names;\nlater files and "
           "flags win), `--print-config` (print the resolved options as JSON and stop), `-v` (more "
           "log\nlines), `-q` (no progress, only warnings and errors), `-h` and `--help`. `-o X` "
           "is `--output X`.\n\n| command | what it does |\n|---|---|\n");
    for (const struct command *c = commands; c->name; c++)
        printf("| [%s](#citysplat-%s) | %s |\n", c->name, c->name, c->about);
    int rc = 0;
    for (const struct command *c = commands; !rc && c->name; c++)
        rc = help_of(c, "--help=markdown");
    return rc;
}

static void print_man_index(void)
{
    options_help_mdoc_head(stdout, "citysplat", about_text);
    printf(".Sh SYNOPSIS\n.Nm\n.Ar command\n.Op Ar arguments\n.Op Ar options\n.Nm\n.Cm "
           "help\n.Op Ar command\n.Sh DESCRIPTION\nThe commands, in their usual order.\n"
           "Each has a page of its own:\n.Bl -tag -width citysplat-import-odm(1)\n");
    for (const struct command *c = commands; c->name; c++) {
        printf(".It Xr citysplat-%s 1\n", c->name);
        options_help_mdoc_text(stdout, c->about);
    }
    printf(".El\n.Sh EXIT STATUS\n0 done, 1 failed, 2 the command line was wrong.\n"
           ".Sh EXAMPLES\n.Bd -literal -offset indent\n%s.Ed\n",
           usual_way);
}

static int print_man(const struct command *c)
{
    char page[64];
    if (!c) {
        print_man_index();
        return 0;
    }
    snprintf(page, sizeof page, "citysplat-%s", c->name);
    options_help_mdoc_head(stdout, page, c->about);
    return help_of(c, "--help=mdoc");
}

static int no_command(const char *name)
{
    const char *near = NULL;
    size_t best = strlen(name) / 2 + 1; /* as of options */
    for (const struct command *c = commands; c->name; c++) {
        size_t far = options_distance(name, c->name);
        if (far <= best && (!near || far < best))
            near = c->name, best = far;
    }
    fprintf(stderr, "citysplat: error: no command '%s'%s%s%s; `citysplat help` lists them\n", name,
            near ? "; did you mean '" : "", near ? near : "", near ? "'?" : "");
    return 2;
}

/* argv[0] is "help". */
static int help(int argc, char **argv)
{
    bool man = argc > 1 && !strcmp(argv[1], "--man");
    if (argc > 1 && !strcmp(argv[1], "--markdown"))
        return print_markdown();
    const char *name = argc > 1 + man ? argv[1 + man] : NULL;
    const struct command *c = name ? command_find(name) : NULL;
    if (name && !c)
        return no_command(name);
    if (man)
        return print_man(c);
    if (c)
        return help_of(c, "--help");
    print_help(stdout);
    return 0;
}

static int completion(const char *shell)
{
    static const char *const shells[] = {"bash", "zsh", "fish"};
    const char *names[sizeof commands / sizeof *commands];
    size_t n = 0, s = 0;
    char form[32];
    while (s < 3 && (!shell || strcmp(shells[s], shell)))
        s++;
    if (s == 3) {
        fprintf(stderr, "citysplat completion: error: '%s' is not bash, zsh or fish\n",
                shell ? shell : "");
        return 2;
    }
    for (const struct command *c = commands; c->name; c++)
        names[n++] = c->name;
    enum options_format format = (enum options_format)(OPTIONS_FORMAT_BASH + (int)s);
    options_completion_head(stdout, names, n, format);
    snprintf(form, sizeof form, "--help=%s", shell);
    int rc = 0;
    for (const struct command *c = commands; !rc && c->name; c++)
        rc = help_of(c, form);
    options_completion_tail(stdout, format);
    return rc;
}

/* Of what was printed without a command: `code`, or 1 if stdout could not be written. */
static int printed(int code)
{
    struct err e = {0};
    if (code || !output_flush(&e))
        return code;
    fprintf(stderr, "citysplat: error: %s\n", e.msg);
    return 1;
}

int main(int argc, char **argv)
{
    setlocale(LC_ALL, "C"); /* numbers are written with a point, whatever the user's language */
    if (worker_asked(argc, argv))
        return draw_main();
    const char *name = argc > 1 ? argv[1] : "help";
    if (!strcmp(name, "--version") || !strcmp(name, "-V")) {
        puts("citysplat " CITYSPLAT_VERSION);
        return printed(0);
    }
    if (!strcmp(name, "help") || !strcmp(name, "--help") || !strcmp(name, "-h"))
        return printed(help(argc - 1, argv + 1));
    if (!strcmp(name, "completion"))
        return printed(completion(argc > 2 ? argv[2] : NULL));
    const struct command *c = command_find(name);
    return c ? run(c, argc - 1, argv + 1, true) : no_command(name);
}
