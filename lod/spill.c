/* Runs of rows in one unlinked file: see spill.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/spill.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "codec/payload.h"
#include "core/simd.h"

enum {
    SPILL_BLOCK_ROWS = 4096,
    SPILL_SOON = 8,
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
        return err_errno(e, ERR_IO, "%s: cannot create the file for rows in between", path);
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

static enum err_code spill_write_at(struct spill *s, const void *bytes, size_t n, uint64_t at,
                                    struct err *e)
{
    const char *p = bytes;
    while (n > 0) {
        ssize_t put = pwrite(s->fd, p, n, (off_t)at);
        if (put < 0 && errno == EINTR)
            continue;
        if (put <= 0)
            return err_errno(e, ERR_IO, "%s: cannot write the rows in between", s->near);
        p += put;
        n -= (size_t)put;
        at += (uint64_t)put;
    }
    return ERR_OK;
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
        rc = spill_write_at(s, block, (end - at) * row, run->offset + at * row, e);
    }
    mem_free(block);
    return rc;
}

enum err_code spill_read(struct spill *s, const struct spill_run *r, size_t from, size_t to,
                         void *out, struct err *e)
{
    size_t row = spill_row_bytes(s, r), n = (to - from) * row;
    uint64_t at = r->offset + from * row;
    char *p = out;
    while (n > 0) {
        ssize_t got = pread(s->fd, p, n, (off_t)at);
        if (got < 0 && errno == EINTR)
            continue;
        if (got <= 0)
            return got < 0 ? err_errno(e, ERR_IO, "%s: cannot read the rows in between", s->near)
                           : err_set(e, ERR_IO, "%s: the rows in between end early", s->near);
        p += got;
        n -= (size_t)got;
        at += (uint64_t)got;
    }
    return ERR_OK;
}

static size_t spill_lower(const struct spill_run *r, uint64_t code)
{
    size_t lo = 0, hi = r->n;
    while (lo < hi) {
        size_t mid = lo + (hi - lo) / 2;
        if (r->code[mid] < code)
            lo = mid + 1;
        else
            hi = mid;
    }
    return lo;
}

void spill_slice(const struct spill_run *r, uint64_t first, uint64_t last, size_t *from, size_t *to)
{
    *from = *to = 0;
    if (!r->code) {
        *to = r->code_first >= first && r->code_first < last ? r->n : 0;
    } else if (r->n > 0 && r->code[0] < last && r->code[r->n - 1] >= first) {
        *from = spill_lower(r, first);
        *to = spill_lower(r, last);
    }
}

void spill_run_free(struct spill_run *r)
{
    mem_free(r->code);
    *r = (struct spill_run){0};
}
