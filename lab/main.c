/* citysplat-lab: the laboratory of citysplat. Finds the command and runs it. stdout is data, stderr
 * is the log. Exit codes: 0 done, 1 failed, 2 the command line was wrong.
 *
 *   citysplat-lab help                the commands
 *   citysplat-lab help COMMAND        one of them, as COMMAND --help
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <locale.h>
#include <stdio.h>
#include <string.h>

#include "cli/base/output.h"
#include "lab/lab.h"
#include "server/drawing/draw.h"

static const struct command {
    const char *name, *about;
    enum err_code (*run)(int argc, char **argv, struct err *e);
    bool benchmark; /* its own name is the first argument of `bench` */
} commands[] = {
#define COMMAND(function, name, about) {name, about, lab_##function, false},
#include "lab/commands.def"
#undef COMMAND
#define BENCH(name, about) {#name, about, lab_bench, true},
#define BENCH_LONG(name, about) BENCH(name, about)
#include "lab/benches.def"
#undef BENCH_LONG
#undef BENCH
};
enum { COMMANDS = sizeof commands / sizeof *commands };

static const struct command *command_find(const char *name)
{
    for (size_t i = 0; i < COMMANDS; i++)
        if (!strcmp(name, commands[i].name))
            return &commands[i];
    return NULL;
}

static int help(FILE *f)
{
    fprintf(f, "citysplat-lab " CITYSPLAT_VERSION " - benchmarks, studies and exact truths\n\n"
               "usage: citysplat-lab COMMAND [arguments] [--options]\n\ncommands:\n");
    for (size_t i = 0; i < COMMANDS; i++) {
        if (i && commands[i].benchmark && !commands[i - 1].benchmark)
            fprintf(f, "\nbenchmarks, several of which may be named:\n");
        fprintf(f, "  %-17s %s\n", commands[i].name, commands[i].about);
    }
    fprintf(f, "\n`citysplat-lab COMMAND --help=all` shows its options.\n");
    if (f != stdout)
        return 2;
    struct err e = {0};
    if (!output_flush(&e))
        return 0;
    fprintf(stderr, "citysplat-lab: error: %s\n", e.msg);
    return 1;
}

static int run(const struct command *c, int argc, char **argv)
{
    struct err e = {0};
    enum err_code rc = c->run(argc, argv, &e);
    if (!rc)
        rc = output_flush(&e);
    if (rc)
        fprintf(stderr, "citysplat-lab %s: error: %s\n", c->name, e.msg[0] ? e.msg : err_text(rc));
    return !rc ? 0 : rc == ERR_ARG ? 2 : 1;
}

int main(int argc, char **argv)
{
    char all[] = "--help=all";
    setlocale(LC_ALL, "C"); /* numbers are written with a point, whatever the user's language */
    if (worker_asked(argc, argv)) /* of a server that is measured */
        return draw_main();
    if (argc < 2)
        return help(stderr);
    bool asks = !strcmp(argv[1], "help") || !strcmp(argv[1], "--help") || !strcmp(argv[1], "-h");
    if (asks && argc < 3)
        return help(stdout);
    const struct command *c = command_find(argv[asks ? 2 : 1]);
    if (!c) {
        fprintf(stderr, "citysplat-lab: error: no command '%s'; `citysplat-lab help` lists them\n",
                argv[asks ? 2 : 1]);
        return 2;
    }
    if (asks)
        return run(c, 2, (char *[]){argv[2], all, NULL});
    return c->benchmark ? run(c, argc, argv) : run(c, argc - 1, argv + 1);
}
