/* Three places of a file and of the ground: see import_fit.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "cli/tiles/import_fit.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "codec/splat/axes.h"
#include "core/base.h"
#include "scene/control/table.h"

/* A triangle this flat does not tell which way is up. */
static const double line_share = 1e-4;
static const double off_share = 0.02; /* of the spread of the places: one of them is wrong */

static enum err_code import_fit_line(const struct table *t, char *line, struct import_fit *f,
                                     struct err *e)
{
    char *field[TABLE_FIELDS];
    double v[6];
    size_t n = table_split(line, '\0', field);
    if (f->n == IMPORT_FIT_MOST)
        return err_set(e, ERR_DATA, "%s: line %zu: more than %d places", t->path, t->line,
                       IMPORT_FIT_MOST);
    if (n > 6)
        return err_set(e, ERR_FORMAT,
                       "%s: line %zu: %zu fields; expected are six: x y z of the file, longitude, "
                       "latitude and ellipsoidal height of the ground, with decimal points",
                       t->path, t->line, n);
    for (size_t k = 0; k < 6; k++)
        if (k >= n || !table_number(field[k], &v[k]))
            return err_set(e, ERR_FORMAT,
                           "%s: line %zu: field %zu is no number; expected are x y z of the file, "
                           "longitude, latitude and ellipsoidal height of the ground",
                           t->path, t->line, k + 1);
    if (fabs(v[3]) > 180 || fabs(v[4]) > 90)
        return err_set(e, ERR_ARG,
                       "%s: line %zu: %.9g %.9g is no longitude and latitude in degrees", t->path,
                       t->line, v[3], v[4]);
    memcpy(f->file[f->n], v, sizeof f->file[0]);
    memcpy(f->ground[f->n++], v + 3, sizeof f->ground[0]);
    return ERR_OK;
}

enum err_code import_fit_read(const char *path, struct import_fit *out, struct err *e)
{
    struct table t;
    char line[TABLE_LINE_MAX];
    bool more = true;
    *out = (struct import_fit){0};
    enum err_code rc = table_open(path, &t, e);
    while (!rc && !(rc = table_next(&t, line, &more, e)) && more)
        if (*line != '#')
            rc = import_fit_line(&t, line, out, e);
    table_close(&t);
    if (!rc && out->n < 3)
        rc = err_set(e, ERR_DATA, "%s: %zu places, three at least are needed", path, out->n);
    return rc;
}

/* Mean square of the distances from the middle, and whether the places lie on a line. */
static double import_fit_spread(const double (*x)[3], size_t n, bool *line)
{
    double mean[3] = {0}, cov[9] = {0}, values[3], vectors[9];
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < 3; k++)
            mean[k] += x[i][k] / (double)n;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < 9; k++)
            cov[k] += (x[i][k / 3] - mean[k / 3]) * (x[i][k % 3] - mean[k % 3]) / (double)n;
    sim3_eigen(cov, 3, values, vectors);
    *line = !(values[1] > line_share * values[2]);
    return values[0] + values[1] + values[2];
}

static enum err_code import_fit_origin(struct import_fit *f, double (*enu)[3], struct err *e)
{
    double lon0 = f->ground[0][0], lon = 0, lat = 0, h = 0, n = (double)f->n;
    for (size_t i = 0; i < f->n; i++) {
        lon += remainder(f->ground[i][0] - lon0, 360) / n; /* across the date line as well */
        lat += f->ground[i][1] / n;
        h += f->ground[i][2] / n;
    }
    f->origin = (struct geo_origin){remainder(lon0 + lon, 360), lat, h};
    enum err_code rc = ERR_OK;
    for (size_t i = 0; !rc && i < f->n; i++)
        rc = geo_to_enu(&f->origin, f->ground[i][0], f->ground[i][1], f->ground[i][2], enu[i], e);
    return rc;
}

enum err_code import_fit_make(struct import_fit *io, const double (*turned)[3], struct err *e)
{
    static const double up[3] = {0, 0, 1};
    double enu[IMPORT_FIT_MOST][3], sum = 0;
    bool line_file, line_ground;
    enum err_code rc = import_fit_origin(io, enu, e);
    if (rc)
        return rc;
    import_fit_spread(turned, io->n, &line_file);
    double spread = sqrt(import_fit_spread((const double(*)[3])enu, io->n, &line_ground));
    if (line_file || line_ground ||
        !sim3_from_pairs(turned, (const double(*)[3])enu, NULL, io->n, up, &io->sim))
        return err_set(e, ERR_DATA,
                       "--origin: the %zu places lie on a line, %s: give one beside it", io->n,
                       line_file ? "in the file" : "on the ground");
    for (size_t i = 0; i < io->n; i++) {
        double at[3], off[3];
        sim3_apply(&io->sim, turned[i], at);
        for (size_t k = 0; k < 3; k++)
            off[k] = at[k] - enu[i][k];
        printf("place %-3zu %+.3f m east, %+.3f north, %+.3f up from the ground's\n", i + 1, off[0],
               off[1], off[2]);
        sum += off[0] * off[0] + off[1] * off[1] + off[2] * off[2];
    }
    printf("fit      %.6g m a unit of the file, RMSE %.3f m at %zu places\n", io->sim.scale,
           sqrt(sum / (double)io->n), io->n);
    if (sqrt(sum / (double)io->n) > off_share * spread)
        log_warn("import",
                 "the places contradict each other by %.3f m: is one of them wrong, or is the file "
                 "mirrored?",
                 sqrt(sum / (double)io->n));
    return ERR_OK;
}

void import_fit_scale(struct gauss *g, double scale)
{
    for (size_t i = 0; i < 3 * g->n; i++) {
        g->mean_m[i] = (float)(scale * (double)g->mean_m[i]);
        g->scale_log[i] = (float)((double)g->scale_log[i] + log(scale));
    }
}

void import_fit_apply(const struct import_fit *f, struct gauss *g)
{
    double origin[3];
    axes_turn(g, f->sim.rot);
    sim3_apply(&f->sim, g->origin_enu_m, origin);
    memcpy(g->origin_enu_m, origin, sizeof g->origin_enu_m);
    import_fit_scale(g, f->sim.scale);
}
