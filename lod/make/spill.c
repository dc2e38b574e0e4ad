/* Runs of rows in one unlinked file: see spill.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/make/spill.h"

#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "codec/splat/payload.h"
#include "core/math/simd.h"
#include "core/splat/gauss.h"
#include "lod/store/locate.h"

enum {
    SPILL_BLOCK_ROWS = 4096,
    SPILL_SOON = 8,
    SPILL_GROUP_ROWS = 16, /* on average, at least */
    SPILL_LINE = 64 / sizeof(float),
    SPILL_REST_MAX = 3 + 4 + 1 + 48 + GAUSS_EMBED_MAX
};

enum err_code spill_open(const char *near, bool lossless, struct spill *out, struct err *e)
{
    char path[FILE_PATH_MAX];
    *out = (struct spill){.fd = -1, .lossless = lossless};
    pthread_mutex_init(&out->lock, NULL);
    snprintf(out->near, sizeof out->near, "%s", near);
    int n = snprintf(path, sizeof path, "%s.spill-%ld", near, (long)getpid());
    if (n < 0 || (size_t)n >= sizeof path)
        return err_set(e, ERR_LIMIT, "%s: path too long", near);
    out->fd = open(path, O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
    if (out->fd < 0)
        return err_errno(e, ERR_IO, "%s: cannot write into its folder", near);
    unlink(path);
    return ERR_OK;
}

void spill_close(struct spill *s)
{
    if (!s->near[0])
        return;
    if (s->fd >= 0)
        close(s->fd);
    pthread_mutex_destroy(&s->lock);
    *s = (struct spill){.fd = -1};
}

static size_t spill_rest(uint32_t sh_degree, uint32_t embed_len)
{
    return 3 + 4 + 1 + 3 * gauss_sh_count(sh_degree) + embed_len;
}

size_t spill_row_bytes(const struct spill *s, const struct spill_run *r)
{
    size_t rest = spill_rest(r->sh_degree, r->embed_len);
    return 3 * sizeof(float) + (s->lossless ? rest * sizeof(float) : rest * sizeof(uint16_t));
}

static void spill_pack(const struct spill *s, const struct gauss *g, size_t i, uint8_t *out)
{
    const size_t n_sh = 3 * gauss_sh_count(g->sh_degree),
                 n = spill_rest(g->sh_degree, g->embed_len);
    float rest[SPILL_REST_MAX];
    uint16_t half[SPILL_REST_MAX];
    memcpy(out, g->mean_m + 3 * i, 3 * sizeof(float));
    memcpy(rest, g->scale_log + 3 * i, 3 * sizeof *rest);
    memcpy(rest + 3, g->quat_wxyz + 4 * i, 4 * sizeof *rest);
    rest[7] = g->opacity_logit[i];
    memcpy(rest + 8, g->sh + n_sh * i, n_sh * sizeof *rest);
    if (g->embed_len)
        memcpy(rest + 8 + n_sh, g->embed + g->embed_len * i, g->embed_len * sizeof *rest);
    if (s->lossless) {
        memcpy(out + 12, rest, n * sizeof *rest);
        return;
    }
    payload_unit_quat(g->quat_wxyz + 4 * i, rest + 3);
    payload_round_sh(rest + 8, n_sh);
    payload_to_float16(rest, n, half);
    memcpy(out + 12, half, n * sizeof *half);
}

void spill_unpack(const struct spill *s, const struct spill_run *r, const void *row,
                  struct gauss *g, size_t i)
{
    const size_t have = 3 * gauss_sh_count(r->sh_degree), want = 3 * gauss_sh_count(g->sh_degree),
                 n = spill_rest(r->sh_degree, r->embed_len);
    float rest[SPILL_REST_MAX];
    uint16_t half[SPILL_REST_MAX];
    const uint8_t *p = (const uint8_t *)row + 12;
    if (s->lossless) {
        memcpy(rest, p, n * sizeof *rest);
    } else {
        memcpy(half, p, n * sizeof *half);
        payload_from_float16(half, n, rest);
    }
    memcpy(g->scale_log + 3 * i, rest, 3 * sizeof *rest);
    memcpy(g->quat_wxyz + 4 * i, rest + 3, 4 * sizeof *rest);
    g->opacity_logit[i] = rest[7];
    memcpy(g->sh + want * i, rest + 8, have * sizeof *rest);
    memset(g->sh + want * i + have, 0, (want - have) * sizeof *rest);
    float *embed = g->embed ? g->embed + g->embed_len * i : NULL;
    if (r->embed_len)
        memcpy(embed, rest + 8 + have, r->embed_len * sizeof *rest);
    if (g->embed_len > r->embed_len)
        memset(embed + r->embed_len, 0, (g->embed_len - r->embed_len) * sizeof *rest);
}

static void spill_soon(const struct gauss *g, size_t i)
{
    const size_t n_sh = 3 * gauss_sh_count(g->sh_degree);
    SIMD_SOON(g->mean_m + 3 * i);
    SIMD_SOON(g->scale_log + 3 * i);
    SIMD_SOON(g->quat_wxyz + 4 * i);
    SIMD_SOON(g->opacity_logit + i);
    for (size_t k = 0; k < n_sh; k += SPILL_LINE)
        SIMD_SOON(g->sh + n_sh * i + k);
}

enum err_code spill_add(struct spill *s, const struct gauss *g, const struct sort_item *order,
                        size_t n, struct spill_run *run, struct err *e)
{
    run->n = n;
    run->sh_degree = g->sh_degree;
    run->embed_len = g->embed_len;
    memcpy(run->origin_enu_m, g->origin_enu_m, sizeof run->origin_enu_m);
    size_t row = spill_row_bytes(s, run);
    uint8_t *block = mem_uninit(SPILL_BLOCK_ROWS, row);
    if (!block)
        return err_set(e, ERR_MEM, "out of memory for %d rows", SPILL_BLOCK_ROWS);
    pthread_mutex_lock(&s->lock);
    run->offset = s->size;
    s->size += n * row;
    pthread_mutex_unlock(&s->lock);
    enum err_code rc = ERR_OK;
    for (size_t at = 0; !rc && at < n; at += SPILL_BLOCK_ROWS) {
        size_t end = at + SPILL_BLOCK_ROWS < n ? at + SPILL_BLOCK_ROWS : n;
        for (size_t i = at; i < end; i++) {
            if (order && i + SPILL_SOON < end)
                spill_soon(g, order[i + SPILL_SOON].row);
            spill_pack(s, g, order ? order[i].row : i, block + (i - at) * row);
        }
        rc = file_write_at(s->fd, s->near, block, (end - at) * row, run->offset + at * row, e);
    }
    mem_free(block);
    return rc;
}

enum err_code spill_read(const struct spill *s, const struct spill_run *r, size_t from, size_t to,
                         void *out, struct err *e)
{
    size_t row = spill_row_bytes(s, r);
    return file_read_at(s->fd, s->near, out, (to - from) * row, r->offset + from * row, e);
}

/* ---- the index ---- */

/* Groups become fewer as their codes lose bits, two a zoom. */
static unsigned spill_choose_shift(const struct sort_item *items, size_t n)
{
    size_t differ[33] = {0}, groups = 1; /* by zooms up to which two neighbours differ */
    for (size_t i = 1; i < n; i++) {
        unsigned zooms = 0;
        for (uint64_t x = items[i].key ^ items[i - 1].key; x; x >>= 2)
            zooms++;
        differ[zooms]++;
    }
    for (unsigned z = 32; z > 0; z--) {
        groups += differ[z]; /* with the last z - 1 zooms left out */
        if (groups > n / SPILL_GROUP_ROWS + 1)
            return 2 * z;
    }
    return 0;
}

enum err_code spill_index(struct spill_run *run, const struct sort_item *items, size_t n,
                          struct err *e)
{
    *run = (struct spill_run){.n = n, .shift = spill_choose_shift(items, n)};
    uint64_t mask = run->shift < 64 ? UINT64_MAX << run->shift : 0;
    size_t groups = n > 0;
    for (size_t i = 1; i < n; i++)
        groups += (items[i].key & mask) != (items[i - 1].key & mask);
    run->group = mem_array(groups, sizeof *run->group);
    if (!run->group)
        return err_set(e, ERR_MEM, "out of memory for the tile codes of %zu Gaussians", n);
    for (size_t i = 0; i < n; i++)
        if (i == 0 || (items[i].key & mask) != (items[i - 1].key & mask))
            run->group[run->n_groups++] = (struct spill_group){items[i].key & mask, (uint32_t)i};
    run->code_first = n ? items[0].key : 0;
    run->code_last = n ? items[n - 1].key : 0;
    return ERR_OK;
}

/* The code of a row, from its mean: what it was sorted by. */
static enum err_code spill_code(const struct spill *s, const struct spill_run *r, size_t row,
                                uint64_t *code, struct err *e)
{
    float mean[3];
    double enu[3];
    struct key k;
    enum err_code rc =
        file_read_at(s->fd, s->near, mean, sizeof mean, r->offset + row * spill_row_bytes(s, r), e);
    for (size_t a = 0; a < 3; a++)
        enu[a] = rc ? 0.0 : (double)mean[a] + r->origin_enu_m[a];
    if (!rc)
        rc = locate_key(s->locate, enu, &k, e);
    *code = rc ? 0 : locate_code(k);
    return rc;
}

/* The last group with a code of at most this one, or the first. */
static size_t spill_group_of(const struct spill_run *r, uint64_t code)
{
    size_t lo = 0, hi = r->n_groups;
    while (lo + 1 < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (r->group[mid].code <= code)
            lo = mid;
        else
            hi = mid;
    }
    return lo;
}

static size_t spill_group_end(const struct spill_run *r, size_t group)
{
    return group + 1 < r->n_groups ? r->group[group + 1].begin : r->n;
}

/* The first row with at least this code. */
static enum err_code spill_lower(const struct spill *s, const struct spill_run *r, uint64_t code,
                                 size_t *out, struct err *e)
{
    size_t g = spill_group_of(r, code), lo = r->group[g].begin, hi = spill_group_end(r, g);
    if (code <= r->group[g].code || code <= r->code_first) {
        *out = lo;
        return ERR_OK;
    }
    if (code >> r->shift != r->group[g].code >> r->shift) {
        *out = hi;
        return ERR_OK;
    }
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        uint64_t here;
        enum err_code rc = spill_code(s, r, mid, &here, e);
        if (rc)
            return rc;
        if (here < code)
            lo = mid + 1;
        else
            hi = mid;
    }
    *out = lo;
    return ERR_OK;
}

enum err_code spill_slice(const struct spill *s, const struct spill_run *r, uint64_t first,
                          uint64_t last, size_t *from, size_t *to, struct err *e)
{
    enum err_code rc = ERR_OK;
    *from = *to = 0;
    if (!r->group) {
        *to = r->code_first >= first && r->code_first < last ? r->n : 0;
    } else if (r->n > 0 && r->code_first < last && r->code_last >= first) {
        *to = r->n;
        if (r->code_first < first)
            rc = spill_lower(s, r, first, from, e);
        if (!rc && r->code_last >= last)
            rc = spill_lower(s, r, last, to, e);
    }
    return rc;
}

enum err_code spill_tile(const struct spill *s, const struct spill_run *r, unsigned shift,
                         size_t from, uint64_t *code, size_t *to, struct err *e)
{
    size_t lo = 0, hi = r->n_groups;
    while (lo + 1 < hi) { /* the group of the row */
        size_t mid = lo + (hi - lo) / 2;
        if (r->group[mid].begin <= from)
            lo = mid;
        else
            hi = mid;
    }
    enum err_code rc = ERR_OK;
    *code = r->group[lo].code;
    if (shift < r->shift)
        rc = spill_code(s, r, from, code, e);
    *code >>= shift;
    *to = r->n;
    if (!rc && r->code_last >> shift != *code)
        rc = spill_lower(s, r, (*code + 1) << shift, to, e);
    return rc;
}

void spill_run_free(struct spill_run *r)
{
    mem_free(r->group);
    *r = (struct spill_run){0};
}
