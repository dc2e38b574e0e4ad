/* INRIA .ply: the file that 3D Gaussian splatting trainers write and every tool reads.
 *
 *   x y z  nx ny nz  f_dc_0..2  f_rest_0..{9,24,45}  opacity  scale_0..2  rot_0..3      all float32
 *
 * f_rest is channel-major (all of red first), the container coefficient-major; opacity is a logit,
 * scale a logarithm, rot is w x y z and need not be of unit length. Reading goes by names, takes
 * every scalar type and byte order, and skips what it does not know. Writing gives float32
 * coordinates, or doubles when one is beyond 4096 m, where float32 steps exceed the 0.25 mm of the
 * other formats. Embeddings are not written. Source: the code of Kerbl et al., 3D Gaussian
 * Splatting, 2023.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/ply.h"
#include "codec/limits.h"
#include "codec/splat/ply_head.h"
#include "core/splat/gauss.h"

#include <errno.h>
#include <fcntl.h>
#include <float.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

/* What writers make of opacity 1 and of flat Gaussians: infinities, brought back to the last
 * sensible value. */
#define OPACITY_LOGIT_MAX 16.0f
#define SCALE_LOG_MIN -23.0f

enum { N_FIXED = 14, N_REST_MAX = 72 }; /* x y z dc opacity scale rot; SH degree 4 is cut to 3 */

static const char *const fixed_names[N_FIXED] = {
    "x",       "y",       "z",       "f_dc_0", "f_dc_1", "f_dc_2", "opacity",
    "scale_0", "scale_1", "scale_2", "rot_0",  "rot_1",  "rot_2",  "rot_3"};

static const char *const ply_rgb_names[3] = {"red", "green", "blue"};
#define PLY_THIN_LOG 6.9077553f /* of a thousandth */

struct columns {
    /* [9] is NULL: two scales, a disc; [8] as well: one, a ball */
    const struct ply_property *fixed[N_FIXED];
    double color_most; /* white of colours that are red, green and blue; 0: they are f_dc */
    const struct ply_property *rest[N_REST_MAX];
    size_t n_rest; /* per channel */
    uint32_t sh_degree;
};

/* White of a colour of this type. */
static double ply_color_most(enum ply_type type)
{
    return type == PLY_U8 ? 255 : type == PLY_U16 ? 65535 : 1;
}

static enum err_code ply_columns_find(const struct ply_element *v, struct columns *out,
                                      struct err *e)
{
    char name[16];
    size_t n = 0;
    for (int i = 0; i < N_FIXED; i++)
        out->fixed[i] = ply_head_property(v, fixed_names[i]);
    if (!out->fixed[3] && !out->fixed[4] && !out->fixed[5]) {
        for (int c = 0; c < 3; c++)
            out->fixed[3 + c] = ply_head_property(v, ply_rgb_names[c]);
        out->color_most = out->fixed[3] ? ply_color_most(out->fixed[3]->type) : 0;
    }
    if (!out->fixed[7] && !out->fixed[10])
        return err_set(e, ERR_FORMAT,
                       "ply: no scale_0 and no rot_0: points or a mesh, not a file of Gaussians");
    for (int i = 0; i < N_FIXED; i++)
        if (!out->fixed[i] && (i < 8 || i > 9 || !out->fixed[7] || (i == 8 && out->fixed[9])))
            return err_set(e, ERR_FORMAT, "ply: property %s is missing", fixed_names[i]);
    for (; n < N_REST_MAX; n++) {
        snprintf(name, sizeof name, "f_rest_%zu", n);
        if (!(out->rest[n] = ply_head_property(v, name)))
            break;
    }
    out->n_rest = n / 3;
    if (n != 0 && n != 9 && n != 24 && n != 45 && n != 72)
        return err_set(e, ERR_FORMAT,
                       "ply: %zu f_rest properties: 0, 9, 24 or 45 make whole SH degrees", n);
    if (n == 72)
        log_warn("ply", "harmonics of degree 4: those above 3 are left out");
    out->sh_degree = n >= 45 ? 3 : n >= 24 ? 2 : n >= 9 ? 1 : 0;
    return ERR_OK;
}

/* Text rows to float64 rows, so that one reader does for both. mem_free *rows. */
static enum err_code ply_ascii_rows(const struct ply_head *h, const struct ply_element *v, size_t n,
                                    double **rows, struct err *e)
{
    bool lists = false, first = true;
    *rows = NULL;
    for (size_t i = 0; &h->elements[i] != v; i++)
        first = first && !h->elements[i].count;
    for (size_t i = 0; i < v->n_props; i++)
        lists = lists || v->props[i].type == PLY_LIST;
    if (!first || lists)
        return err_set(e, ERR_FORMAT,
                       "ply: in text form the vertices must come first and hold no lists");
    if (n > h->n_body / (2 * v->n_props) + 1)
        return err_set(e, ERR_FORMAT, "ply: %zu rows announced in %zu bytes of text: truncated", n,
                       h->n_body);
    char *text = mem_array(h->n_body + 1, 1), *p = text, *end;
    double *out = *rows = mem_array(n, v->n_props * sizeof *out);
    enum err_code rc = text && out ? ERR_OK : err_set(e, ERR_MEM, "ply: out of memory");
    if (!rc && h->n_body)
        memcpy(text, h->body, h->n_body);
    for (size_t i = 0; !rc && i < n * v->n_props; i++, p = end) {
        out[i] = strtod(p, &end);
        if (end != p && *end == '#') { /* "-1.#IND" of Microsoft's library */
            out[i] = (double)NAN;
            end += strcspn(end, " \t\r\n");
        }
        if (end == p)
            rc = err_set(e, ERR_FORMAT, "ply: row %zu: not a number, or truncated", i / v->n_props);
        /* a value too many or too few would move those of all further rows */
        else if ((i + 1) % v->n_props == 0 && !strchr("\r\n", end[strspn(end, " \t")]))
            rc = err_set(e, ERR_FORMAT, "ply: row %zu: its line does not end after %zu values",
                         i / v->n_props, v->n_props);
    }
    mem_free(text);
    return rc;
}

struct source { /* binary rows, or ASCII ones as doubles */
    const struct ply_head *head;
    const uint8_t *rows;
    size_t row_bytes, width;
    const double *text;
};

static double ply_source_get(const struct source *s, size_t row, const struct ply_property *p)
{
    return s->text ? s->text[row * s->width + p->offset]
                   : ply_head_value(s->head, p, s->rows + row * s->row_bytes);
}

/* Coordinates in double: the origin goes to the middle of the box, on a whole metre, if it is far.
 */
static void ply_means_read(const struct source *s, const struct columns *col, struct gauss *g)
{
    double lo[3] = {DBL_MAX, DBL_MAX, DBL_MAX}, hi[3] = {-DBL_MAX, -DBL_MAX, -DBL_MAX};
    for (int c = 0; c < 3; c++) {
        if (col->fixed[c]->type == PLY_F64 || s->text)
            for (size_t i = 0; i < g->n; i++) {
                double v = ply_source_get(s, i, col->fixed[c]);
                if (!isfinite(v))
                    continue;
                lo[c] = v < lo[c] ? v : lo[c];
                hi[c] = v > hi[c] ? v : hi[c];
            }
        double far = fmax(fabs(lo[c]), fabs(hi[c]));
        g->origin_enu_m[c] = far > PLY_FLOAT_REACH_M && lo[c] <= hi[c] && far < 1e9
                                 ? round(lo[c] / 2 + hi[c] / 2)
                                 : 0;
    }
    for (size_t i = 0; i < g->n; i++)
        for (int c = 0; c < 3; c++)
            g->mean_m[3 * i + c] =
                (float)(ply_source_get(s, i, col->fixed[c]) - g->origin_enu_m[c]);
}

/* Red, green and blue as floats end at 1, or at 255 if any row of the file has more than 1. */
static void ply_color_range(const struct source *s, struct columns *col, size_t n)
{
    for (size_t i = 0; i < n && col->color_most == 1; i++)
        for (size_t c = 3; c < 6; c++)
            if (ply_source_get(s, i, col->fixed[c]) > 1.01)
                col->color_most = 255;
}

/* Little-endian float32 in the order of trainers, as nearly all files have it. */
static bool ply_rows_plain(const struct source *s, const struct columns *col)
{
    const struct ply_property *const *f = col->fixed;
    if (s->text || s->head->format != PLY_LITTLE || col->color_most > 0 || !f[9])
        return false;
    for (size_t i = 0; i < N_FIXED; i++)
        if (f[i]->type != PLY_F32)
            return false;
    for (size_t i = 0; i < 3 * col->n_rest; i++)
        if (col->rest[i]->type != PLY_F32)
            return false;
    return f[1]->offset == f[0]->offset + 4 && f[2]->offset == f[0]->offset + 8 &&
           f[4]->offset == f[3]->offset + 4 && f[5]->offset == f[3]->offset + 8 &&
           f[8]->offset == f[7]->offset + 4 && f[9]->offset == f[7]->offset + 8 &&
           f[11]->offset == f[10]->offset + 4 && f[12]->offset == f[10]->offset + 8 &&
           f[13]->offset == f[10]->offset + 12;
}

static void ply_rows_copy(const struct source *s, const struct columns *col, struct gauss *g)
{
    const size_t k = gauss_sh_count(g->sh_degree), n_rest = k - 1;
    const struct ply_property *const *f = col->fixed;
    memset(g->origin_enu_m, 0, sizeof g->origin_enu_m);
    for (size_t i = 0; i < g->n; i++) {
        const uint8_t *row = s->rows + i * s->row_bytes;
        float *sh = g->sh + 3 * k * i, *ln = g->scale_log + 3 * i, logit;
        memcpy(g->mean_m + 3 * i, row + f[0]->offset, 12);
        memcpy(sh, row + f[3]->offset, 12);
        for (size_t c = 0; c < 3; c++)
            for (size_t r = 0; r < n_rest; r++)
                memcpy(sh + 3 * (r + 1) + c, row + col->rest[c * col->n_rest + r]->offset, 4);
        memcpy(&logit, row + f[6]->offset, 4);
        g->opacity_logit[i] = isinf(logit) ? copysignf(OPACITY_LOGIT_MAX, logit) : logit;
        memcpy(ln, row + f[7]->offset, 12);
        for (size_t c = 0; c < 3; c++)
            ln[c] = ln[c] < SCALE_LOG_MIN && !isfinite(ln[c]) ? SCALE_LOG_MIN : ln[c];
        memcpy(g->quat_wxyz + 4 * i, row + f[10]->offset, 16);
    }
}

static void ply_rows_read(const struct source *s, const struct columns *col, struct gauss *g)
{
    if (ply_rows_plain(s, col)) {
        ply_rows_copy(s, col, g);
        return;
    }
    const size_t k = gauss_sh_count(g->sh_degree), n_rest = k - 1;
    ply_means_read(s, col, g);
    for (size_t i = 0; i < g->n; i++) {
        float *sh = g->sh + 3 * k * i;
        float *scale = g->scale_log + 3 * i;
        for (size_t c = 0; c < 3; c++) {
            float ln = col->fixed[7 + c] ? (float)ply_source_get(s, i, col->fixed[7 + c])
                       : col->fixed[8]   ? fminf(scale[0], scale[1]) - PLY_THIN_LOG
                                         : scale[0];
            scale[c] = ln < SCALE_LOG_MIN && !isfinite(ln) ? SCALE_LOG_MIN : ln;
            sh[c] = (float)ply_source_get(s, i, col->fixed[3 + c]);
            if (col->color_most > 0)
                sh[c] = (float)(((double)sh[c] / col->color_most - 0.5) / GAUSS_SH_C0);
            for (size_t r = 0; r < n_rest; r++)
                sh[3 * (r + 1) + c] = (float)ply_source_get(s, i, col->rest[c * col->n_rest + r]);
        }
        float logit = (float)ply_source_get(s, i, col->fixed[6]);
        g->opacity_logit[i] = isinf(logit) ? copysignf(OPACITY_LOGIT_MAX, logit) : logit;
        for (size_t c = 0; c < 4; c++)
            g->quat_wxyz[4 * i + c] = (float)ply_source_get(s, i, col->fixed[10 + c]);
    }
}

static enum err_code ply_inria_read(const struct ply_head *h, const struct codec_limits *lim,
                                    struct gauss *out, struct err *e)
{
    const struct ply_element *v = ply_head_element(h, "vertex");
    struct columns col = {0};
    double *text = NULL;
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    if (!v)
        return err_set(e, ERR_FORMAT, "ply: no element vertex");
    enum err_code rc = ply_columns_find(v, &col, e);
    if (!rc && v->count > most)
        rc = err_set(e, ERR_LIMIT, "ply: %zu Gaussians: the limit is %zu", v->count, most);
    if (!rc && h->format == PLY_ASCII)
        rc = ply_ascii_rows(h, v, v->count, &text, e);
    else if (!rc && !v->rows)
        rc = err_set(e, ERR_FORMAT,
                     "ply: the vertices stand behind or hold lists, which are not read");
    if (!rc)
        rc = gauss_alloc(out, v->count, col.sh_degree, 0, e);
    if (!rc) {
        struct source s = {h, v->rows, v->row_bytes, v->n_props, text};
        out->n = v->count;
        out->antialiased = h->antialiased;
        ply_color_range(&s, &col, out->n);
        ply_rows_read(&s, &col, out);
        rc = gauss_keep_good(out, "ply", e);
    }
    if (rc)
        gauss_free(out);
    mem_free(text);
    return rc;
}

/* ---- a file larger than memory ---- */

enum {
    PLY_HEAD_MAX = 4 << 20, /* more than the longest head that is understood */
    PLY_SLICE = 1 << 16     /* rows of a part that is only looked at */
};

struct ply_stream {
    char path[FILE_PATH_MAX];
    int fd;
    struct ply_head head;
    const struct ply_element *vertex;
    struct columns col;
};

/* The head of the open file; *fits: its rows can be read in parts. */
static enum err_code ply_stream_head(struct ply_stream *s, bool *fits, struct err *e)
{
    struct stat st;
    if (fstat(s->fd, &st))
        return err_errno(e, ERR_IO, "%s", s->path);
    if (!S_ISREG(st.st_mode))
        return err_set(e, ERR_IO, "%s: no file, but a folder, a pipe or a device", s->path);
    const size_t size = (size_t)st.st_size, n = size < PLY_HEAD_MAX ? size : PLY_HEAD_MAX;
    uint8_t *bytes = mem_uninit(PLY_HEAD_MAX, 1);
    enum err_code rc =
        bytes ? file_read_at(s->fd, s->path, bytes, n, 0, e) : err_set(e, ERR_MEM, "out of memory");
    if (!rc)
        rc = ply_head_read_of(bytes, n, size, &s->head, e);
    mem_free(bytes);
    s->vertex = rc ? NULL : ply_head_element(&s->head, "vertex");
    *fits = s->vertex && s->vertex->rows_at && s->vertex->row_bytes && !ply_packed_is(&s->head);
    if (*fits)
        rc = ply_columns_find(s->vertex, &s->col, e);
    return rc;
}

/* Some rows as they lie in the file; *rows is freed by the caller, also after an error. */
static enum err_code ply_stream_rows_read(const struct ply_stream *s, size_t first, size_t n,
                                          uint8_t **rows, struct err *e)
{
    const struct ply_element *v = s->vertex;
    *rows = mem_uninit(n, v->row_bytes);
    return *rows ? file_read_at(s->fd, s->path, *rows, n * v->row_bytes,
                                v->rows_at + (uint64_t)first * v->row_bytes, e)
                 : err_set(e, ERR_MEM, "%s: out of memory for %zu rows", s->path, n);
}

/* One range for all parts of the file. */
static enum err_code ply_stream_color_range(struct ply_stream *s, struct err *e)
{
    const struct ply_element *v = s->vertex;
    enum err_code rc = ERR_OK;
    for (size_t at = 0; !rc && s->col.color_most == 1 && at < v->count; at += PLY_SLICE) {
        const size_t n = v->count - at < PLY_SLICE ? v->count - at : PLY_SLICE;
        uint8_t *rows = NULL;
        rc = ply_stream_rows_read(s, at, n, &rows, e);
        const struct source from = {&s->head, rows, v->row_bytes, v->n_props, NULL};
        if (!rc)
            ply_color_range(&from, &s->col, n);
        mem_free(rows);
    }
    return rc;
}

enum err_code ply_stream_open(const char *path, struct ply_stream **out, struct ply_info *info,
                              struct err *e)
{
    bool fits = false;
    *out = NULL;
    struct ply_stream *s = mem_array(1, sizeof *s);
    if (!s)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    snprintf(s->path, sizeof s->path, "%s", path);
    s->fd = open(path, O_RDONLY | O_CLOEXEC);
    enum err_code rc = s->fd < 0 ? err_errno(e, errno == ENOENT ? ERR_NOENT : ERR_IO, "%s", path)
                                 : ply_stream_head(s, &fits, e);
    if (rc && rc != ERR_IO && rc != ERR_NOENT)
        err_add(e, "%s", path);
    if (!rc && fits)
        rc = ply_stream_color_range(s, e);
    if (rc || !fits) {
        ply_stream_close(&s);
        return rc;
    }
    *info = s->head.info;
    *out = s;
    return ERR_OK;
}

void ply_stream_close(struct ply_stream **s)
{
    if (*s) {
        ply_head_free(&(*s)->head);
        if ((*s)->fd >= 0)
            close((*s)->fd);
    }
    mem_free(*s);
    *s = NULL;
}

struct ply_rows ply_stream_rows(const struct ply_stream *s)
{
    return (struct ply_rows){.n = s->vertex->count,
                             .sh_degree = s->col.sh_degree,
                             .antialiased = s->head.antialiased,
                             .doubles = s->col.fixed[0]->type == PLY_F64};
}

enum err_code ply_stream_read(const struct ply_stream *s, size_t first, size_t n, struct gauss *out,
                              struct err *e)
{
    const struct ply_element *v = s->vertex;
    *out = (struct gauss){0};
    if (first > v->count || n > v->count - first)
        return err_set(e, ERR_ARG, "%s: rows %zu to %zu of %zu", s->path, first, first + n,
                       v->count);
    uint8_t *rows = NULL;
    enum err_code rc = ply_stream_rows_read(s, first, n, &rows, e);
    if (!rc)
        rc = gauss_uninit(out, n, s->col.sh_degree, 0, e);
    if (!rc) {
        const struct source from = {&s->head, rows, v->row_bytes, v->n_props, NULL};
        out->n = n;
        out->antialiased = s->head.antialiased;
        ply_rows_read(&from, &s->col, out);
    }
    if (rc)
        gauss_free(out);
    mem_free(rows);
    return rc;
}

enum err_code ply_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct ply_info *info, struct err *e)
{
    struct ply_head h;
    *out = (struct gauss){0};
    enum err_code rc = ply_head_read(bytes, n, &h, e);
    if (!rc)
        rc = ply_packed_is(&h) ? ply_packed_read(&h, lim, out, e) : ply_inria_read(&h, lim, out, e);
    if (!rc && info)
        *info = h.info;
    ply_head_free(&h);
    return rc;
}

enum err_code ply_read(const char *path, const struct codec_limits *lim, struct gauss *out,
                       struct ply_info *info, struct err *e)
{
    struct buf b = {0};
    *out = (struct gauss){0};
    enum err_code rc =
        file_read(path, lim && lim->max_bytes ? lim->max_bytes : CODEC_MAX_BYTES, &b, e);
    if (!rc && (rc = ply_decode(b.data, b.size, lim, out, info, e)) != ERR_OK)
        err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}

/* ---- writing ---- */

void ply_encode_head(const struct ply_rows *r, const struct ply_info *info, struct buf *out)
{
    size_t n_rest = 3 * (gauss_sh_count(r->sh_degree) - 1);
    ply_head_comments(info, r->antialiased, out);
    buf_printf(out, "element vertex %zu\n", r->n);
    for (int c = 0; c < 3; c++)
        buf_printf(out, "property %s %c\n", r->doubles ? "double" : "float", "xyz"[c]);
    buf_printf(out, "property float nx\nproperty float ny\nproperty float nz\n");
    for (int i = 3; i < 6; i++)
        buf_printf(out, "property float %s\n", fixed_names[i]);
    for (size_t i = 0; i < n_rest; i++)
        buf_printf(out, "property float f_rest_%zu\n", i);
    for (int i = 6; i < N_FIXED; i++)
        buf_printf(out, "property float %s\n", fixed_names[i]);
    buf_printf(out, "end_header\n");
}

size_t ply_row_bytes(const struct ply_rows *r)
{
    return 3 * (r->doubles ? sizeof(double) : sizeof(float)) +
           sizeof(float) * (3 + 3 * gauss_sh_count(r->sh_degree) + 1 + 3 + 4);
}

void ply_encode_rows(const struct gauss *g, bool doubles, uint8_t *out)
{
    const size_t k = gauss_sh_count(g->sh_degree), n_rest = k - 1, n_tail = 3 + 3 * k + 1 + 3 + 4;
    uint8_t *p = out;
    for (size_t i = 0; i < g->n; i++) {
        const float *sh = g->sh + 3 * k * i;
        float tail[3 + 48 + 8] = {0}, *t = tail + 3; /* normals 0 */
        for (size_t c = 0; c < 3; c++) {
            double v = (double)g->mean_m[3 * i + c] + g->origin_enu_m[c];
            float f = (float)v;
            memcpy(p, doubles ? (const void *)&v : &f, doubles ? 8 : 4);
            p += doubles ? 8 : 4;
            *t++ = sh[c];
        }
        for (size_t c = 0; c < 3; c++)
            for (size_t r = 1; r <= n_rest; r++)
                *t++ = sh[3 * r + c];
        *t++ = g->opacity_logit[i];
        memcpy(t, g->scale_log + 3 * i, 12);
        memcpy(t + 3, g->quat_wxyz + 4 * i, 16);
        memcpy(p, tail, 4 * n_tail);
        p += 4 * n_tail;
    }
}

enum err_code ply_encode(const struct gauss *g, const struct ply_info *info, struct buf *out,
                         struct err *e)
{
    struct ply_rows rows = {.n = g->n, .sh_degree = g->sh_degree, .antialiased = g->antialiased};
    size_t bad = 0, start = out->size;
    if (gauss_count_bad(g, &bad))
        return err_set(e, ERR_DATA, "ply: row %zu: not finite, or no rotation", bad);
    for (size_t i = 0; i < 3 * g->n && !rows.doubles; i++)
        rows.doubles = fabs((double)g->mean_m[i] + g->origin_enu_m[i % 3]) > PLY_FLOAT_REACH_M;
    if (rows.doubles && g->origin_enu_m[0] == 0 && g->origin_enu_m[1] == 0 &&
        g->origin_enu_m[2] == 0)
        rows.doubles = false; /* they are float32 already */
    ply_encode_head(&rows, info, out);
    const size_t row = ply_row_bytes(&rows);
    uint8_t *p = g->n <= SIZE_MAX / row ? buf_grow(out, g->n * row) : NULL;
    if (!p) {
        out->size = start;
        return err_set(e, ERR_MEM, "ply: %zu Gaussians: out of memory", g->n);
    }
    ply_encode_rows(g, rows.doubles, p);
    return ERR_OK;
}
