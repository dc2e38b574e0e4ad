/* citysplat: drone photographs in, a city of Gaussians that a web map can stream out.
 *
 * Finds the command and runs it. stdout is data, stderr is the log. Exit codes: 0 done, 1 failed, 2
 * the command line was wrong. This is the only file that turns an error into text and an exit code.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <locale.h>
#include <stdio.h>
#include <string.h>

#include "cli/cli.h"

struct command {
    const char *name, *about;
    enum err_code (*run)(int argc, char **argv, struct err *e);
};

static const struct command commands[] = {
#define COMMAND(name, about) {#name, about, cli_##name},
#include "cli/commands.def"
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

static void print_help(FILE *f)
{
    fprintf(f, "citysplat " CITYSPLAT_VERSION
               " - drone photographs to a city of 3D Gaussians that any web map can stream\n\n"
               "usage: citysplat COMMAND [arguments] [--options]\n\ncommands:\n");
    for (const struct command *c = commands; c->name; c++)
        fprintf(f, "  %-9s %s\n", c->name, c->about);
    fprintf(
        f, "\n`citysplat help COMMAND` tells about one of them. The usual way:\n"
           "  citysplat ingest photos/ photos/sparse/0 -o scene   # poses + GPS -> metres, "
           "east-north-up\n"
           "  citysplat train scene                               # Gaussians at three levels of "
           "detail\n"
           "  citysplat tile scene -o city.tiles                  # z/x/y pyramid in one file\n"
           "  citysplat serve city.tiles                          # open http://127.0.0.1:8080/\n");
}

static int run(const struct command *c, int argc, char **argv)
{
    struct err e = {0};
    enum err_code rc = c->run(argc, argv, &e);
    if (rc == ERR_OK)
        return 0;
    fprintf(stderr, "citysplat %s: error: %s\n", c->name, e.msg[0] ? e.msg : err_text(rc));
    if (rc == ERR_ARG)
        fprintf(stderr, "`citysplat help %s` lists the options.\n", c->name);
    return rc == ERR_ARG ? 2 : 1;
}

int main(int argc, char **argv)
{
    setlocale(LC_ALL, "C"); /* numbers are written with a point, whatever the user's language */
    const char *name = argc > 1 ? argv[1] : "help";
    if (!strcmp(name, "--version") || !strcmp(name, "-V")) {
        puts("citysplat " CITYSPLAT_VERSION);
        return 0;
    }
    bool help = !strcmp(name, "help") || !strcmp(name, "--help") || !strcmp(name, "-h");
    if (help && argc < 3) {
        print_help(stdout);
        return 0;
    }
    if (help)
        name = argv[2];
    const struct command *c = command_find(name);
    if (!c) {
        fprintf(stderr, "citysplat: error: no command '%s'; `citysplat help` lists them\n", name);
        return 2;
    }
    if (help) {
        char flag[] = "--help";
        char *help_argv[] = {argv[2], flag, NULL};
        return run(c, 2, help_argv);
    }
    return run(c, argc - 1, argv + 1);
}
