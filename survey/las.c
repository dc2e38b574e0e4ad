/* LAS 1.4: see las.h. Layout after "LAS Specification 1.4 - R15", ASPRS 2019: a header of 375
 * bytes, whose counts and bounds are filled in at the end, one variable length record with the WKT,
 * points of 36 bytes. All little-endian.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "survey/las.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "core/base.h"

enum {
    LAS_HEAD_BYTES = 375,
    LAS_RECORD_HEAD_BYTES = 54,
    LAS_POINT_BYTES = 36,
    LAS_FORMAT = 7,         /* with colours, without a waveform */
    LAS_WKT = 1 << 4,       /* of the global encoding */
    LAS_WKT_RECORD = 2112,  /* of LASF_Projection */
    LAS_UNCLASSIFIED = 1,   /* processed, no class */
    LAS_ONLY_RETURN = 0x11, /* the first of one */
};

struct las {
    char path[FILE_PATH_MAX], part[FILE_PATH_MAX];
    char source[32];
    FILE *file;
    double offset_m[3], min_m[3], max_m[3]; /* bounds: of what was written, rounded */
    unsigned year, day;
    size_t start; /* of the points */
    uint64_t n;
    struct buf buf;
};

static enum err_code las_put(struct las *l, struct err *e)
{
    enum err_code rc = buf_check(&l->buf, e);
    if (!rc && fwrite(l->buf.data, 1, l->buf.size, l->file) != l->buf.size)
        rc = err_errno(e, ERR_IO, "%s: cannot write", l->path);
    l->buf.size = 0;
    return rc;
}

/* n bytes of text, zeros behind it. */
static void las_text(struct buf *b, const char *text, size_t n)
{
    size_t len = strnlen(text, n);
    buf_add(b, text, len);
    for (size_t i = len; i < n; i++)
        buf_u8(b, 0);
}

static void las_head(struct las *l)
{
    struct buf *b = &l->buf;
    buf_add(b, "LASF", 4);
    buf_u16(b, 0); /* file source */
    buf_u16(b, LAS_WKT);
    las_text(b, "", 16); /* project */
    buf_u8(b, 1);
    buf_u8(b, 4);
    las_text(b, l->source, 32);
    las_text(b, "citysplat " CITYSPLAT_VERSION, 32);
    buf_u16(b, l->day);
    buf_u16(b, l->year);
    buf_u16(b, LAS_HEAD_BYTES);
    buf_u32(b, (uint32_t)l->start);
    buf_u32(b, 1); /* variable length records */
    buf_u8(b, LAS_FORMAT);
    buf_u16(b, LAS_POINT_BYTES);
    las_text(b, "", 4 + 5 * 4); /* counts of before 1.4: 0 for this format */
    for (size_t k = 0; k < 3; k++)
        buf_f64(b, LAS_STEP_M);
    for (size_t k = 0; k < 3; k++)
        buf_f64(b, l->offset_m[k]);
    for (size_t k = 0; k < 3; k++) {
        buf_f64(b, l->max_m[k]);
        buf_f64(b, l->min_m[k]);
    }
    las_text(b, "", 8 + 8 + 4); /* no waveforms, no extended records */
    buf_u64(b, l->n);
    buf_u64(b, l->n); /* of first returns */
    las_text(b, "", 14 * 8);
}

static void las_record(struct las *l, const char *wkt)
{
    struct buf *b = &l->buf;
    buf_u16(b, 0);
    las_text(b, "LASF_Projection", 16);
    buf_u16(b, LAS_WKT_RECORD);
    buf_u16(b, (unsigned)strlen(wkt) + 1);
    las_text(b, "OGC WKT", 32);
    buf_add(b, wkt, strlen(wkt) + 1);
}

/* Day of the year, 1 is the first of January; 0 0 where the text is no date. */
static void las_date(const char *text, unsigned *year, unsigned *day)
{
    static const unsigned before[] = {0, 31, 59, 90, 120, 151, 181, 212, 243, 273, 304, 334};
    unsigned y, m, d;
    *year = *day = 0;
    if (!text || sscanf(text, "%4u-%2u-%2u", &y, &m, &d) != 3 || m < 1 || m > 12 || d < 1 || d > 31)
        return;
    *year = y;
    *day = before[m - 1] + d + (m > 2 && ((y % 4 == 0 && y % 100 != 0) || y % 400 == 0));
}

enum err_code las_create(const char *path, const struct las_info *info, struct las **out,
                         struct err *e)
{
    size_t wkt = strlen(info->wkt) + 1;
    *out = NULL;
    if (wkt > UINT16_MAX)
        return err_set(e, ERR_LIMIT, "%s: a coordinate system of %zu bytes: at most 65535", path,
                       wkt);
    struct las *l = mem_array(1, sizeof *l);
    if (!l)
        return err_set(e, ERR_MEM, "%s: out of memory", path);
    enum err_code rc = file_begin(path, l->part, e);
    if (rc)
        goto out;
    snprintf(l->path, sizeof l->path, "%s", path);
    snprintf(l->source, sizeof l->source, "%s", info->source);
    memcpy(l->offset_m, info->offset_m, sizeof l->offset_m);
    for (size_t k = 0; k < 3; k++) {
        l->min_m[k] = HUGE_VAL;
        l->max_m[k] = -HUGE_VAL;
    }
    las_date(info->created, &l->year, &l->day);
    l->start = LAS_HEAD_BYTES + LAS_RECORD_HEAD_BYTES + wkt;
    l->file = fopen(l->part, "wb");
    if (!l->file) {
        rc = err_errno(e, ERR_IO, "%s: cannot create", path);
        goto out;
    }
    las_head(l); /* room for it */
    las_record(l, info->wkt);
    rc = las_put(l, e);
out:
    if (rc)
        las_close(&l);
    *out = l;
    return rc;
}

static unsigned las_color(float v)
{
    return (unsigned)(fminf(fmaxf(v, 0), 1) * 65535 + 0.5f);
}

enum err_code las_add(struct las *l, const struct las_point *p, size_t n, struct err *e)
{
    struct buf *b = &l->buf;
    for (size_t i = 0; i < n; i++) {
        for (size_t k = 0; k < 3; k++) {
            double step = floor((p[i].at_m[k] - l->offset_m[k]) / LAS_STEP_M + 0.5);
            if (!(fabs(step) <= INT32_MAX))
                return err_set(
                    e, ERR_ARG, "%s: a place at %.3f m, %.3f m from the offset: at most %.0f",
                    l->path, p[i].at_m[k], p[i].at_m[k] - l->offset_m[k], INT32_MAX * LAS_STEP_M);
            buf_u32(b, (uint32_t)(int32_t)step);
            l->min_m[k] = fmin(l->min_m[k], l->offset_m[k] + step * LAS_STEP_M);
            l->max_m[k] = fmax(l->max_m[k], l->offset_m[k] + step * LAS_STEP_M);
        }
        buf_u16(b, 0); /* intensity */
        buf_u8(b, LAS_ONLY_RETURN);
        buf_u8(b, 0);
        buf_u8(b, p[i].class ? p[i].class : LAS_UNCLASSIFIED);
        buf_u8(b, 0);
        buf_u16(b, 0); /* scan angle: straight down */
        buf_u16(b, 0); /* source */
        buf_u64(b, 0); /* GPS time: none */
        for (size_t k = 0; k < 3; k++)
            buf_u16(b, las_color(p[i].rgb[k]));
    }
    l->n += n;
    return las_put(l, e);
}

enum err_code las_commit(struct las **lp, struct err *e)
{
    struct las *l = *lp;
    enum err_code rc = l->n ? ERR_OK : err_set(e, ERR_DATA, "%s: there are no points", l->path);
    if (!rc && fseek(l->file, 0, SEEK_SET))
        rc = err_errno(e, ERR_IO, "%s: cannot write its header", l->path);
    if (!rc) {
        las_head(l);
        rc = las_put(l, e);
    }
    int bad = fclose(l->file);
    l->file = NULL;
    if (!rc && bad)
        rc = err_errno(e, ERR_IO, "%s: cannot close", l->path);
    if (!rc)
        rc = file_commit(l->part, l->path, e);
    las_close(lp);
    return rc;
}

void las_close(struct las **lp)
{
    struct las *l = *lp;
    if (!l)
        return;
    if (l->file)
        fclose(l->file);
    if (*l->part)
        file_abort(l->part); /* what was renamed is not there */
    buf_free(&l->buf);
    mem_free(l);
    *lp = NULL;
}
