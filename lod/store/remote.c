/* Reading an object in blocks, with what probably comes next in the same request.
 *
 * A part of a file that is read in order gets larger requests, each twice the one before. A tile is
 * a page of the index beside a chain of pages that was written just before or just after it; who
 * reads one says how long it is, and gets the neighbourhood on both sides.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/store/remote.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "lod/store/blocks.h"

enum {
    REMOTE_RUN_MAX = 128,   /* blocks of one request: 8 MiB */
    REMOTE_KEEP = 32,       /* blocks of memory that are kept for the next one */
    REMOTE_AROUND_MAX = 12, /* blocks before a page that are read with it */
    REMOTE_PAGES = 24576    /* bytes of pages of the index that are read beside a tile */
};
static const double REMOTE_DOWN_S = 1; /* a server that does not answer is left alone */

struct remote {
    struct range *range;
    struct blocks *blocks;
    char shown[RANGE_URL_MAX];
    uint64_t n, have, next; /* blocks; have: the one in `block`; next: after the last request */
    size_t run;             /* blocks of the last request in order */
    uint64_t expect;
    struct err failed;
    uint8_t *part; /* [cap blocks] of a request */
    size_t cap;
    uint8_t block[BLOCKS_BYTES];
};

static double remote_wait_s = 15;
static _Thread_local double remote_end_s;

void remote_patience(double wait_s)
{
    remote_wait_s = wait_s;
}

void remote_until(double until_s)
{
    remote_end_s = until_s;
}

static double remote_deadline(void)
{
    const double until_s = clock_s() + remote_wait_s;
    return remote_end_s > 0 ? fmin(remote_end_s, until_s) : until_s;
}

enum err_code remote_open(const char *url, int *fd, struct err *e)
{
    struct range *r = NULL;
    struct blocks *b = NULL;
    struct range_object o = {0};
    size_t got = 0;
    *fd = -1;
    uint8_t *first = mem_uninit(1, BLOCKS_BYTES);
    enum err_code rc =
        first ? range_open(url, &r, e) : err_set(e, ERR_MEM, "out of memory for a remote store");
    if (!rc)
        rc = range_get(r, &o, 0, BLOCKS_BYTES, first, &got, remote_deadline(), e);
    if (!rc)
        rc = blocks_make(url, &o, fd, e);
    if (!rc)
        rc = blocks_attach(*fd, &b, e);
    if (!rc) {
        blocks_put(b, 0, first);
        blocks_note_changed(b, false);
        blocks_note_down(b, 0);
    }
    blocks_detach(&b);
    range_close(&r);
    mem_free(first);
    if (rc && *fd >= 0) {
        close(*fd);
        *fd = -1;
    }
    return rc;
}

bool remote_is(int fd)
{
    return blocks_is(fd);
}

enum err_code remote_attach(int fd, struct remote **out, struct err *e)
{
    struct remote *r = mem_array(1, sizeof *r);
    *out = r;
    if (!r)
        return err_set(e, ERR_MEM, "out of memory for a remote store");
    enum err_code rc = blocks_attach(fd, &r->blocks, e);
    if (!rc)
        rc = range_open(blocks_url(r->blocks), &r->range, e);
    if (rc) {
        remote_close(out);
        return rc;
    }
    range_show(blocks_url(r->blocks), r->shown);
    r->n = (blocks_object(r->blocks)->size_bytes + BLOCKS_BYTES - 1) / BLOCKS_BYTES;
    r->have = r->next = UINT64_MAX;
    return ERR_OK;
}

void remote_close(struct remote **out)
{
    struct remote *r = *out;
    *out = NULL;
    if (!r)
        return;
    range_close(&r->range);
    blocks_detach(&r->blocks);
    mem_free(r->part);
    mem_free(r);
}

const char *remote_shown(const struct remote *r)
{
    return r->shown;
}

uint64_t remote_size(const struct remote *r)
{
    return blocks_object(r->blocks)->size_bytes;
}

void remote_expect(struct remote *r, uint64_t bytes)
{
    r->expect = bytes;
}

/* Which blocks [from, to) to ask for, so that block b is among them. */
static void remote_choose(struct remote *r, uint64_t b, uint64_t *from, uint64_t *to)
{
    uint64_t before = 0, after = 1;
    if (r->expect) {
        const uint64_t blocks = (r->expect + REMOTE_PAGES) / BLOCKS_BYTES + 1;
        const bool again = b == r->next; /* the page was read: this is the chain */
        before = again ? 0 : blocks < REMOTE_AROUND_MAX ? blocks : 1;
        after = again || blocks < REMOTE_AROUND_MAX ? blocks : 1;
    } else if (b == r->next) {
        after = 2 * r->run;
    }
    after = after < REMOTE_RUN_MAX ? after : REMOTE_RUN_MAX;
    *from = *to = b;
    while (*to < r->n && *to - b < after && !(*to > b && blocks_has(r->blocks, *to)))
        ++*to;
    while (*from && b - *from < before && !blocks_has(r->blocks, *from - 1))
        --*from;
}

static enum err_code remote_room(struct remote *r, size_t blocks, struct err *e)
{
    if (blocks <= r->cap)
        return ERR_OK;
    uint8_t *more = mem_uninit(blocks, BLOCKS_BYTES);
    if (!more)
        return err_set(e, ERR_MEM, "%s: out of memory for %zu blocks", r->shown, blocks);
    mem_free(r->part);
    r->part = more;
    r->cap = blocks;
    return ERR_OK;
}

static enum err_code remote_fetch(struct remote *r, uint64_t b, struct err *e)
{
    uint64_t from, to;
    size_t got = 0;
    struct range_object o = *blocks_object(r->blocks);
    if (blocks_changed(r->blocks))
        return err_set(e, ERR_BUSY, "%s: it was replaced at its server", r->shown);
    if (blocks_down(r->blocks))
        return err_set(e, ERR_BUSY, "%s: its server does not answer", r->shown);
    remote_choose(r, b, &from, &to);
    enum err_code rc = remote_room(r, (size_t)(to - from), e);
    if (rc)
        return rc;
    const double start_s = clock_s();
    rc = range_get(r->range, &o, from * BLOCKS_BYTES, (size_t)(to - from) * BLOCKS_BYTES, r->part,
                   &got, remote_deadline(), e);
    if (rc == ERR_DATA)
        blocks_note_changed(r->blocks, true);
    else if (rc && rc != ERR_MEM && clock_s() - start_s > REMOTE_DOWN_S)
        blocks_note_down(r->blocks, REMOTE_DOWN_S);
    if (rc)
        return rc == ERR_MEM ? rc : err_set(e, ERR_BUSY, "%s", e->msg);
    for (uint64_t i = from; i < to; i++)
        blocks_put(r->blocks, i, r->part + (i - from) * BLOCKS_BYTES);
    memcpy(r->block, r->part + (b - from) * BLOCKS_BYTES, blocks_size(r->blocks, b));
    if (r->cap > REMOTE_KEEP) {
        mem_free(r->part);
        r->part = NULL;
        r->cap = 0;
    }
    r->run = (size_t)(to - b);
    r->next = to;
    return ERR_OK;
}

/* Reads block b into r->block, from the file or from the server. */
static enum err_code remote_take(struct remote *r, uint64_t b, struct err *e)
{
    if (b == r->have)
        return ERR_OK;
    r->have = UINT64_MAX;
    enum err_code rc = blocks_get(r->blocks, b, r->block) ? ERR_OK : remote_fetch(r, b, e);
    if (rc)
        r->failed = *e;
    else
        r->have = b;
    return rc;
}

enum err_code remote_read(struct remote *r, uint64_t at, void *out, size_t n, struct err *e)
{
    struct err own = {0};
    uint8_t *to = out;
    e = e ? e : &own;
    while (n) {
        const uint64_t b = at / BLOCKS_BYTES;
        const size_t skip = (size_t)(at % BLOCKS_BYTES), left = BLOCKS_BYTES - skip,
                     part = n < left ? n : left;
        const enum err_code rc = remote_take(r, b, e);
        if (rc)
            return rc;
        memcpy(to, r->block + skip, part);
        to += part;
        at += part;
        n -= part;
    }
    return ERR_OK;
}

const struct err *remote_failed(const struct remote *r)
{
    return &r->failed;
}

void remote_forgive(struct remote *r)
{
    r->failed = (struct err){0};
}

bool remote_changed(const struct remote *r)
{
    return blocks_changed(r->blocks);
}

enum err_code remote_check(struct remote *r, double wait_s, struct err *e)
{
    const enum err_code rc = range_check(r->range, blocks_object(r->blocks), clock_s() + wait_s, e);
    if (rc == ERR_DATA)
        blocks_note_changed(r->blocks, true);
    return rc;
}
