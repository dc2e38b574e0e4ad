/* Turns an error into text and an exit code: see outcome.h. Exit codes: 0 done, 1 failed, 2 the
 * command line was wrong; of serve, which supervisors start, those of sysexits.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/base/outcome.h"

#include <stdio.h>
#include <string.h>
#include <sysexits.h>

#include "core/base.h"

/* What a supervisor may try again (69, 75) and what a person has to mend (64, 65, 66, 78). */
static int outcome_of_service(enum err_code rc, int argc, char *const *argv)
{
    static const int codes[] = {
        [ERR_ARG] = EX_USAGE,       [ERR_MEM] = EX_OSERR,          [ERR_IO] = EX_IOERR,
        [ERR_NOENT] = EX_NOINPUT,   [ERR_FORMAT] = EX_DATAERR,     [ERR_LIMIT] = EX_DATAERR,
        [ERR_DATA] = EX_DATAERR,    [ERR_DEVICE] = EX_UNAVAILABLE, [ERR_BUSY] = EX_UNAVAILABLE,
        [ERR_CANCEL] = EX_TEMPFAIL, [ERR_INTERNAL] = EX_SOFTWARE,
    };
    for (int i = 1; i < argc; i++) {
        if (!strcmp(argv[i], "--check"))
            return EX_CONFIG;
        if (rc == ERR_ARG && !strncmp(argv[i], "--config", 8))
            return EX_CONFIG;
    }
    return codes[rc];
}

int outcome_tell(const char *command, enum err_code rc, const struct err *e, int argc,
                 char *const *argv)
{
    if (!rc)
        return 0;
    const char *why = e->msg[0] ? e->msg : err_text(rc);
    if (log_is_json())
        log_error(command, "%s", why);
    else
        fprintf(stderr, "%scitysplat %s: error: %s\n", log_priority(LOG_ERROR), command, why);
    if (rc == ERR_ARG && !log_is_json())
        fprintf(stderr, "`citysplat help %s` lists the options.\n", command);
    return !strcmp(command, "serve") ? outcome_of_service(rc, argc, argv) : rc == ERR_ARG ? 2 : 1;
}
