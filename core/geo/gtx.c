/* Geoid grids: see gtx.h.
 *
 * The format is that of NOAA's VDatum, big-endian: four doubles (latitude and longitude of the
 * south-west node, both steps), two 32-bit counts (rows, columns), then rows of float32 from the
 * south. -88.8888 means that nothing is known.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "core/geo/gtx.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"

enum { GTX_HEAD = 40 };

struct gtx {
    double south_deg, west_deg, step_lat_deg, step_lon_deg;
    size_t rows, columns;
    float *m; /* [rows][columns], NAN: not known */
};

static uint64_t gtx_big(const uint8_t *p, size_t n)
{
    uint64_t v = 0;
    for (size_t i = 0; i < n; i++)
        v = v << 8 | p[i];
    return v;
}

static double gtx_f64(const uint8_t *p)
{
    uint64_t bits = gtx_big(p, 8);
    double v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

static float gtx_f32(const uint8_t *p)
{
    uint32_t bits = (uint32_t)gtx_big(p, 4);
    float v;
    memcpy(&v, &bits, sizeof v);
    return v;
}

static enum err_code gtx_parse(const char *path, const struct buf *b, struct gtx *g, struct err *e)
{
    if (b->size < GTX_HEAD)
        return err_set(e, ERR_FORMAT, "%s: too short for a geoid grid", path);
    g->south_deg = gtx_f64(b->data);
    g->west_deg = gtx_f64(b->data + 8);
    g->step_lat_deg = gtx_f64(b->data + 16);
    g->step_lon_deg = gtx_f64(b->data + 24);
    g->rows = (size_t)gtx_big(b->data + 32, 4);
    g->columns = (size_t)gtx_big(b->data + 36, 4);
    if (!(fabs(g->south_deg) <= 90) || !(fabs(g->west_deg) <= 360) || !(g->step_lat_deg > 1e-6) ||
        !(g->step_lon_deg > 1e-6) || !(g->step_lat_deg <= 90) || !(g->step_lon_deg <= 180))
        return err_set(e, ERR_FORMAT, "%s: no geoid grid: its corner or its steps are none", path);
    if (g->rows < 2 || g->columns < 2 || g->rows > (b->size - GTX_HEAD) / 4 / g->columns)
        return err_set(e, ERR_FORMAT, "%s: %zu x %zu values do not fit its size", path, g->rows,
                       g->columns);
    g->m = mem_array(g->rows * g->columns, sizeof *g->m);
    if (!g->m)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    for (size_t i = 0; i < g->rows * g->columns; i++) {
        float v = gtx_f32(b->data + GTX_HEAD + 4 * i);
        g->m[i] = fabsf(v) < 1000 && fabsf(v + 88.8888f) > 1e-3f ? v : NAN;
    }
    return ERR_OK;
}

enum err_code gtx_open(const char *path, struct gtx **out, struct err *e)
{
    struct buf b = {0};
    struct gtx *g = mem_array(1, sizeof *g);
    *out = NULL;
    enum err_code rc =
        g ? file_read(path, 0, &b, e) : err_set(e, ERR_MEM, "%s: out of memory", path);
    if (!rc)
        rc = gtx_parse(path, &b, g, e);
    buf_free(&b);
    if (rc)
        gtx_close(&g);
    *out = g;
    return rc;
}

void gtx_close(struct gtx **g)
{
    if (*g)
        mem_free((*g)->m);
    mem_free(*g);
    *g = NULL;
}

double gtx_above(const struct gtx *g, double lon_deg, double lat_deg)
{
    double y = (lat_deg - g->south_deg) / g->step_lat_deg,
           x = remainder(lon_deg - g->west_deg, 360) / g->step_lon_deg;
    bool around = (double)g->columns * g->step_lon_deg > 360 - 1e-6;
    if (x < 0)
        x += 360 / g->step_lon_deg;
    if (!(y >= 0) || y > (double)(g->rows - 1) || !(x >= 0) ||
        (!around && x > (double)(g->columns - 1)))
        return (double)NAN;
    size_t r = (size_t)fmin(floor(y), (double)(g->rows - 2)), c = (size_t)x % g->columns,
           next = around               ? (c + 1) % g->columns
                  : c + 1 < g->columns ? c + 1
                                       : c;
    double t = y - (double)r, s = x - floor(x);
    const float *a = g->m + r * g->columns, *b = a + g->columns;
    return (1 - t) * ((1 - s) * (double)a[c] + s * (double)a[next]) +
           t * ((1 - s) * (double)b[c] + s * (double)b[next]);
}

bool gtx_find(const char *name, char path[FILE_PATH_MAX])
{
    const char *const dirs[] = {getenv("PROJ_DATA"), getenv("PROJ_LIB"), "/usr/share/proj",
                                "/usr/local/share/proj"};
    for (size_t k = 0; k < sizeof dirs / sizeof *dirs; k++)
        if (dirs[k] && *dirs[k] && !file_join(path, dirs[k], name, NULL) && file_exists(path))
            return true;
    return false;
}
