/* citysplat-study: keeps the records of studies and draws the charts and tables of docs/ from them.
 * studies/study.sh runs the studies. Exit codes: 0 done, 1 failed, 2 the command line was wrong.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <locale.h>
#include <stdio.h>
#include <string.h>

#include "studies/study.h"

static const struct study_command {
    const char *name, *about;
    enum err_code (*run)(int argc, char **argv, struct err *e);
} study_commands[] = {
    {"record", "write the numbers of a run into a file of recorded runs", study_record},
    {"chart", "draw the charts and write the tables of recorded runs", study_chart},
};
enum { STUDY_COMMANDS = sizeof study_commands / sizeof *study_commands };

static int study_help(FILE *f)
{
    fprintf(f, "usage: citysplat-study COMMAND [arguments] [--options]\n\ncommands:\n");
    for (size_t i = 0; i < STUDY_COMMANDS; i++)
        fprintf(f, "  %-8s %s\n", study_commands[i].name, study_commands[i].about);
    fprintf(f, "\n`citysplat-study COMMAND --help` tells about one of them.\n");
    return f == stdout ? 0 : 2;
}

int main(int argc, char **argv)
{
    setlocale(LC_NUMERIC, "C");
    if (argc < 2)
        return study_help(stderr);
    if (!strcmp(argv[1], "-h") || !strcmp(argv[1], "--help") || !strcmp(argv[1], "help"))
        return study_help(stdout);
    for (size_t i = 0; i < STUDY_COMMANDS; i++) {
        struct err e = {0};
        if (strcmp(argv[1], study_commands[i].name))
            continue;
        enum err_code rc = study_commands[i].run(argc - 1, argv + 1, &e);
        if (rc)
            fprintf(stderr, "citysplat-study %s: error: %s\n", argv[1],
                    e.msg[0] ? e.msg : err_text(rc));
        return !rc ? 0 : rc == ERR_ARG ? 2 : 1;
    }
    fprintf(stderr, "citysplat-study: error: no command '%s'\n", argv[1]);
    return study_help(stderr);
}
