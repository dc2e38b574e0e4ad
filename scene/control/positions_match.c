/* Which position is of which photograph: by name, number or time.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/positions.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "core/math/sort.h"
#include "scene/control/table.h"

static enum err_code positions_match_names(const struct positions *p, struct position_photo *photos,
                                           size_t n, struct err *e)
{
    struct table_renamed renamed = {0};
    for (size_t i = 0; i < n; i++) {
        size_t most = 0, other = SIZE_MAX;
        photos[i].position = SIZE_MAX;
        for (size_t k = 0; k < p->n; k++) {
            size_t alike = table_alike(photos[i].name, p->list[k].image);
            if (alike && alike == most)
                other = k;
            if (alike <= most)
                continue;
            most = alike;
            other = SIZE_MAX;
            photos[i].position = k;
        }
        if (other != SIZE_MAX)
            return err_set(e, ERR_DATA,
                           "positions: lines %zu and %zu both fit %.200s: name photographs with "
                           "their folders, and each once",
                           p->list[photos[i].position].line, p->list[other].line, photos[i].name);
        if (most)
            table_rename(&renamed, photos[i].name, p->list[photos[i].position].image);
    }
    table_tell_renamed(&renamed, "--positions");
    return ERR_OK;
}

/* The number of a photograph by its name: DJI_<14 digits>_<number>_..., whatever follows, as a
 * waypoint or a lens has digits too; else the last group of digits without the ending. SIZE_MAX:
 * none. */
static size_t positions_number(const char *name)
{
    static const char digits[] = "0123456789";
    enum { DJI = 4, TIME = 14 };
    const char *slash = strrchr(name, '/'), *base = slash ? slash + 1 : name,
               *end = strrchr(base, '.');
    if (!strncmp(base, "DJI_", DJI) && strspn(base + DJI, digits) == TIME &&
        base[DJI + TIME] == '_') {
        const char *number = base + DJI + TIME + 1;
        const size_t n = strspn(number, digits);
        if (n && n < 10 && (number[n] == '_' || number[n] == '.'))
            return (size_t)strtoul(number, NULL, 10);
    }
    end = end ? end : base + strlen(base);
    while (end > base && !(end[-1] >= '0' && end[-1] <= '9'))
        end--;
    const char *p = end;
    while (p > base && p[-1] >= '0' && p[-1] <= '9' && end - p < 9)
        p--;
    return p < end ? (size_t)strtoul(p, NULL, 10) : SIZE_MAX;
}

/* Do the photograph's name or its folder begin as the .MRK's does? */
static bool positions_of_flight(const char *name, const char *prefix)
{
    const char *slash = strrchr(name, '/'), *base = slash ? slash + 1 : name, *folder = name;
    for (const char *q = name; slash && q < slash; q++)
        folder = *q == '/' ? q + 1 : folder;
    size_t n = strlen(prefix);
    return !strncmp(base, prefix, n) ||
           (slash && (size_t)(slash - folder) == n && !strncmp(folder, prefix, n));
}

static enum err_code positions_match_numbers(const struct positions *p,
                                             struct position_photo *photos, size_t n, struct err *e)
{
    bool named = false;
    for (size_t i = 0; i < n; i++)
        for (size_t k = 0; k < p->n && !named; k++)
            named = positions_of_flight(photos[i].name, p->list[k].image);
    if (!named && p->files > 1)
        return err_set(e, ERR_DATA,
                       "positions: no photograph or folder is named as '%s' is: which of %zu .MRK "
                       "files belongs to which cannot be told",
                       p->list[0].image, p->files);
    for (size_t i = 0; i < n; i++) {
        size_t number = positions_number(photos[i].name);
        photos[i].position = SIZE_MAX;
        for (size_t k = 0; k < p->n; k++)
            if (p->list[k].number == number &&
                (!named || positions_of_flight(photos[i].name, p->list[k].image)))
                photos[i].position = k;
        for (size_t j = 0; j < i && photos[i].position != SIZE_MAX; j++)
            if (photos[j].position == photos[i].position)
                return err_set(e, ERR_DATA,
                               "positions: %.100s and %.100s both are photograph %zu of the .MRK: "
                               "give one .MRK a folder",
                               photos[j].name, photos[i].name, number);
    }
    return ERR_OK;
}

static int positions_order_compare(const void *a, const void *b)
{
    const double *p = a, *q = b;
    return p[0] != q[0] ? (p[0] < q[0] ? -1 : 1) : (p[1] > q[1]) - (p[1] < q[1]);
}

/* Clock of photographs plus shift, against that of positions, both [..][2] (time, index) in order:
 * how many fit within a second, one to one; their positions into `out` [n], SIZE_MAX: none. */
static size_t positions_shifted(const double (*photo)[2], size_t n, const double (*at)[2], size_t m,
                                double shift, size_t *out)
{
    size_t k = 0, fits = 0;
    for (size_t i = 0; i < n; i++) {
        double t = photo[i][0] + shift;
        out[i] = SIZE_MAX;
        while (k < m && at[k][0] < t - 1.01)
            k++;
        if (k < m && at[k][0] <= t + 1.01) {
            out[i] = (size_t)at[k++][1];
            fits++;
        }
    }
    return fits;
}

/* Median distance of GPS from the positions, metres roughly; 0: no GPS. */
static double positions_apart(const struct positions *p, const struct position_photo *photos,
                              const double (*photo)[2], size_t n, const size_t *match,
                              double *scratch)
{
    size_t k = 0;
    for (size_t i = 0; i < n; i++) {
        const struct position_photo *f = &photos[(size_t)photo[i][1]];
        if (match[i] == SIZE_MAX || !f->has_gps)
            continue;
        const double *at = p->list[match[i]].at;
        scratch[k++] =
            111320 * hypot((at[0] - f->lon_deg) * cos(f->lat_deg / 57.2957795), at[1] - f->lat_deg);
    }
    return sort_median(scratch, k);
}

struct positions_clock {
    double (*photo)[2], (*at)[2], *scratch;
    size_t *match, *best, n;
};

/* Try every shift that brings one of the first photographs onto a position. */
static size_t positions_try(const struct positions *p, const struct position_photo *photos,
                            struct positions_clock *c)
{
    size_t most = 0;
    double least = HUGE_VAL;
    for (size_t i = 0; i < c->n && i < 3; i++)
        for (size_t k = 0; k < p->n; k++) {
            size_t fits =
                positions_shifted((const double(*)[2])c->photo, c->n, (const double(*)[2])c->at,
                                  p->n, c->at[k][0] - c->photo[i][0], c->match);
            if (10 * fits < 9 * c->n || 10 * fits < 9 * most)
                continue;
            double apart = positions_apart(p, photos, (const double(*)[2])c->photo, c->n, c->match,
                                           c->scratch);
            if (fits <= most && !(apart < least))
                continue;
            most = fits > most ? fits : most;
            least = apart;
            memcpy(c->best, c->match, c->n * sizeof *c->best);
        }
    return most;
}

static enum err_code positions_match_times(const struct positions *p, struct position_photo *photos,
                                           size_t n, struct err *e)
{
    struct positions_clock c = {.photo = mem_array(n, sizeof *c.photo),
                                .at = mem_array(p->n, sizeof *c.at),
                                .scratch = mem_array(n, sizeof *c.scratch),
                                .match = mem_array(n, sizeof *c.match),
                                .best = mem_array(n, sizeof *c.best)};
    bool room = c.photo && c.at && c.scratch && c.match && c.best;
    enum err_code rc = room ? ERR_OK : err_set(e, ERR_MEM, "out of memory for positions");
    for (size_t i = 0; room && i < n; i++) {
        photos[i].position = SIZE_MAX;
        if (!isfinite(photos[i].time_s))
            continue;
        c.photo[c.n][0] = photos[i].time_s;
        c.photo[c.n++][1] = (double)i;
    }
    for (size_t k = 0; room && k < p->n; k++) {
        c.at[k][0] = p->list[k].time_s;
        c.at[k][1] = (double)k;
    }
    if (room) {
        qsort(c.photo, c.n, sizeof *c.photo, positions_order_compare);
        qsort(c.at, p->n, sizeof *c.at, positions_order_compare);
    }
    if (!rc && p->n > 3 * n + 10)
        rc = err_set(e, ERR_DATA,
                     "positions: %zu for %zu photographs: that is the way of the receiver, not the "
                     "camera's events; give the .pos of events (Emlid: *_events.pos)",
                     p->n, n);
    size_t fits = rc ? 0 : positions_try(p, photos, &c);
    if (!rc && (c.n < n || !fits))
        rc = err_set(e, ERR_DATA,
                     "positions: %zu of %zu photographs say their time, and no difference of "
                     "clocks brings nine tenths of them onto the %zu positions",
                     c.n, n, p->n);
    for (size_t i = 0; !rc && i < c.n; i++)
        photos[(size_t)c.photo[i][1]].position = c.best[i];
    mem_free(c.photo);
    mem_free(c.at);
    mem_free(c.scratch);
    mem_free(c.match);
    mem_free(c.best);
    return rc;
}

enum err_code positions_match(const struct positions *p, struct position_photo *photos, size_t n,
                              struct err *e)
{
    return p->by == POSITION_BY_NAME     ? positions_match_names(p, photos, n, e)
           : p->by == POSITION_BY_NUMBER ? positions_match_numbers(p, photos, n, e)
                                         : positions_match_times(p, photos, n, e);
}
