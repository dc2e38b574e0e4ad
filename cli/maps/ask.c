/* Questions about a surface from the command line: see ask.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/maps/ask.h"

#include <math.h>
#include <stdio.h>

#include <jansson.h>

#include "cli/maps/maps.h"

/* Parses "LON,LAT". */
static enum err_code ask_place(const char *text, double out[2], struct err *e)
{
    if (!number_list(text, 2, out) || !(fabs(out[0]) <= 180) || !(fabs(out[1]) <= 90))
        return err_set(e, ERR_ARG, "'%s': LON,LAT in degrees is expected, e.g. 8.6821,50.1109",
                       text);
    return ERR_OK;
}

/* The options' table has the most, and 0 for a default. */
static enum err_code ask_length(const char *option, double m, struct err *e)
{
    return m == 0.0 || m >= QUERY_LEAST_M
               ? ERR_OK
               : err_set(e, ERR_ARG, "%s: %g: 0, or at least %g m is expected", option, m,
                         QUERY_LEAST_M);
}

enum err_code ask_print(const struct options_args *args, const struct ask_options *o,
                        struct query *q, struct err *e)
{
    struct nadir_options no = {.device = o->device};
    struct geoid *geoid = NULL;
    struct nadir *n = NULL;
    json_t *answer = NULL;
    enum err_code rc = ask_length("--gsd-m", q->gsd_m, e);
    if (!rc)
        rc = ask_length("--step-m", q->step_m, e);
    for (size_t i = 1; !rc && i < args->n; i++) /* before the store is opened */
        rc = ask_place(args->arg[i], q->place[q->n++], e);
    if (!rc)
        rc = options_number_of("--ceiling-m", o->ceiling_m, (double)NAN, &no.ceiling_m, e);
    if (!rc && o->geoid)
        rc = geoid_open(o->geoid, &geoid, e);
    if (!rc)
        rc = nadir_open(args->arg[0], &no, &n, e);
    if (!rc && geoid && !heights_ellipsoidal(store_info(nadir_store(n))->heights))
        rc = err_set(e, ERR_ARG,
                     "--geoid: heights of this store count from '%s', not from the ellipsoid, so "
                     "no geoid can be taken off; give --geoid to ingest",
                     store_info(nadir_store(n))->heights);
    if (!rc)
        rc = query_answer(n, geoid, q, &answer, e);
    if (!rc) {
        json_dumpf(answer, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(13));
        printf("\n");
    }
    json_decref(answer);
    nadir_close(&n);
    geoid_close(&geoid);
    return rc == ERR_DATA ? ERR_ARG : rc; /* the question's fault */
}
