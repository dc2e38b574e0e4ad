/* Readers of streams of pictures that follow a camera, and who steers them.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef TESTS_READER_H
#define TESTS_READER_H

#include "codec/image/image.h"
#include "server/answers/view_stream.h"
#include "server/http/multipart.h"
#include "tests/server/client.h"

static const char NAME[] = "0123456789abcdef";

/* ---- a reader ---- */

struct part {
    char type[32];
    long long pose;
    unsigned width, height;
    int rest, key, quantizer;
    size_t bytes, at; /* at: in the body of the reader */
    double at_s;
};
struct reader {
    int fd;
    struct buf raw, body; /* as it came; without chunks */
    size_t at, chunk_at;  /* bytes of body that were read; bytes of raw that were unchunked */
    bool ended, last_chunk;
};

static inline void reader_open(struct reader *r, const char *target)
{
    char q[200];
    const int small = 8192; /* few bytes wait on the way */
    memset(r, 0, sizeof *r);
    r->fd = dial(t.port);
    (void)setsockopt(r->fd, SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
    snprintf(q, sizeof q, "GET /d/toy/motion/%s HTTP/1.1\r\n" H "\r\n", target);
    say(r->fd, q);
}

static inline void reader_close(struct reader *r)
{
    close(r->fd);
    buf_free(&r->raw);
    buf_free(&r->body);
}

/* Takes whole chunks out of the bytes that came. */
static inline void reader_unchunk(struct reader *r)
{
    buf_add(&r->raw, "", 1);
    r->raw.size--;
    const char *text = (const char *)r->raw.data;
    if (!r->chunk_at) {
        const char *end = strstr(text, "\r\n\r\n");
        if (!end)
            return;
        assert_int_equal(atoi(text + 9), 200);
        assert_non_null(strstr(text, "multipart/x-mixed-replace; boundary=" MULTIPART_BOUNDARY));
        assert_non_null(strstr(text, "Cache-Control: no-store"));
        r->chunk_at = (size_t)(end + 4 - text);
    }
    for (;;) {
        const char *line = text + r->chunk_at, *end = strstr(line, "\r\n");
        if (!end)
            return;
        size_t n = strtoul(line, NULL, 16), from = (size_t)(end + 2 - text);
        if (from + n + 2 > r->raw.size)
            return;
        r->last_chunk |= n == 0;
        buf_add(&r->body, text + from, n);
        r->chunk_at = from + n + 2;
    }
}

/* Checks that the bytes are a picture of the size in the part's head. */
static inline void check_picture(const char *bytes, const struct part *p)
{
    struct err e = {0};
    char path[FILE_PATH_MAX];
    uint32_t width, height;
    kit_ok(file_join(path, t.dir, "part", &e), e);
    kit_ok(file_write(path, bytes, p->bytes, &e), e);
    kit_ok(image_read_info(path, &width, &height, NULL, NULL, &e), e);
    assert_int_equal(width, p->width);
    assert_int_equal(height, p->height);
}

/* Reads the next part; false: the stream has ended, or no whole part came within wait_s. */
static inline bool reader_next(struct reader *r, double wait_s, struct part *out)
{
    static const char mark[] = "--" MULTIPART_BOUNDARY "\r\n";
    memset(out, 0, sizeof *out);
    for (double end_s = clock_s() + wait_s;;) {
        buf_add(&r->body, "", 1);
        r->body.size--;
        const char *text = (const char *)r->body.data + r->at;
        size_t n = r->body.size - r->at;
        const char *end = n > sizeof mark ? strstr(text, "\r\n\r\n") : NULL;
        if (end) {
            assert_memory_equal(text, mark, sizeof mark - 1);
            size_t head = (size_t)(end + 4 - text);
            assert_int_equal(
                sscanf(strstr(text, "Content-Type: "), "Content-Type: %31s", out->type), 1);
            out->bytes = (size_t)atoll(strstr(text, "Content-Length: ") + 16);
            out->pose = atoll(strstr(text, "Pose: ") + 6);
            out->rest = atoi(strstr(text, "Rest: ") + 6);
            const char *key = strstr(text, "\r\nKey: ");
            out->key = key && key < end ? atoi(key + 7) : -1;
            out->quantizer = key && key < end ? atoi(strstr(key, "Quantizer: ") + 11) : -1;
            out->at = r->at + head;
            assert_int_equal(
                sscanf(strstr(text, "Size: "), "Size: %ux%u", &out->width, &out->height), 2);
            /* the delimiter behind it has come as well: browsers show it only then */
            if (n >= head + out->bytes + 2 + sizeof mark - 1) {
                out->at_s = clock_s();
                if (!strncmp(out->type, "image/", 6))
                    check_picture(text + head, out);
                r->at += head + out->bytes + 2;
                return true;
            }
        }
        if (r->ended || clock_s() > end_s)
            return false;
        r->ended = !hear_some(r->fd, &r->raw, 0.1);
        reader_unchunk(r);
    }
}

/* ---- who steers ---- */

static inline int steer(const char *name, int number, double heading, int width, const char *more)
{
    struct buf q = {0}, body = {0};
    struct reply r;
    buf_printf(&body,
               "{\"pose\":{\"lon\":13.398,\"lat\":52.4985,\"height\":150,\"heading\":%.3f,"
               "\"pitch\":-40,\"fov\":55},\"width\":%d,\"height\":%d,\"number\":%d%s}",
               heading, width, width * 3 / 4, number, more);
    buf_printf(&q,
               "POST /d/toy/motion/%s HTTP/1.1\r\n" H
               "Connection: close\r\nContent-Length: %zu\r\n\r\n",
               name, body.size);
    buf_add(&q, body.data, body.size);
    int fd = dial(t.port);
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, true, NULL, &r);
    close(fd);
    buf_free(&q);
    buf_free(&body);
    buf_free(&r.raw);
    return r.status;
}

static inline struct view_stream_counts counts(void)
{
    struct view_stream_counts c;
    view_stream_count(server_services(t.server)->view_streams, &c);
    return c;
}

static inline void await_streams(uint64_t n)
{
    kit_await(counts().streams == n);
}

/* A server that draws, or the test is skipped. */
static inline void start_drawing(void)
{
    if (!start_with_device())
        skip();
}

#endif
