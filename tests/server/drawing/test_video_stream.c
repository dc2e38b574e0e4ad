/* Streams as video: frames decode and show what /render draws, key frames come where they are
 * needed, a slow line gets coarser frames and a slow reader fewer and no late ones, encoders go
 * with their readers, and where there is no encoder the pictures are JPEG.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/video.h"
#include "server/drawing/video_stream.h"
#include "tests/server/reader.h"
#include "train/loss/metric.h"

#include <math.h>
#include <signal.h>

static const char VIDEO[] = "0123456789abcdef?video=vp9";

/* ---- size and quality, without a server ---- */

static void test_memory_for_encoders(void **state)
{
    struct video_stream_room room = {.limit_bytes = video_room(640, 360), .threads = 1};
    struct video_stream_shot shot;
    if (!video_can())
        skip();
    struct video_stream *first = video_stream_begin(&room), *second = video_stream_begin(&room);
    assert_true(video_stream_next(first, 640, 360, 1e6, 60, &shot));
    assert_int_equal(shot.width_px, 640);
    assert_false(video_stream_next(second, 640, 360, 1e6, 60, &shot)); /* all is taken */
    assert_int_equal(room.held_bytes, video_room(640, 360));
    video_stream_drop(&first);
    assert_int_equal(room.held_bytes, 0);
    assert_true(video_stream_next(second, 640, 360, 1e6, 60, &shot));
    video_stream_drop(&second);
    assert_int_equal(room.held_bytes, 0);
    assert_int_equal(room.encoders, 0);
}

/* A line that is slow makes frames coarser, then smaller; one that is quick again undoes it. */
static void test_quality_follows_the_line(void **state)
{
    struct video_stream_room room = {.limit_bytes = SIZE_MAX, .threads = 1};
    struct video_stream_told told;
    struct video_stream_shot first, shot;
    if (!video_can())
        skip();
    struct video_stream *f = video_stream_begin(&room);
    assert_true(video_stream_next(f, 640, 360, 1e6, 60, &first));
    assert_true(video_stream_next(f, 640, 360, 1e6, 20, &shot));
    assert_true(shot.quantizer > first.quantizer); /* a client that wants less */
    shot = first;
    int last = first.quantizer;
    for (int i = 0; i < 80; i++) {
        assert_true(video_stream_next(f, 640, 360, 1e6, 60, &shot));
        (void)video_stream_shown(f, 0.02, 0.04, &told);
        video_stream_sent(f, 0.2);
        assert_true(shot.quantizer >= last && shot.quantizer <= VIDEO_QUANTIZER_MOST);
        last = shot.quantizer;
    }
    assert_true(last > first.quantizer + 20 && shot.width_px < first.width_px / 2);
    for (int i = 0; i < 300; i++) {
        assert_true(video_stream_next(f, 640, 360, 1e6, 60, &shot));
        (void)video_stream_shown(f, 0.02, 0.04, &told);
        video_stream_sent(f, 0.001);
    }
    assert_int_equal(shot.quantizer, first.quantizer);
    assert_int_equal(shot.width_px, first.width_px);
    video_stream_drop(&f);
}

/* Frames that take long to make are smaller; a single long one changes nothing. */
static void test_size_follows_the_time(void **state)
{
    struct video_stream_room room = {.limit_bytes = SIZE_MAX, .threads = 1};
    struct video_stream_told told;
    struct video_stream_shot shot;
    if (!video_can())
        skip();
    struct video_stream *f = video_stream_begin(&room);
    for (int i = 0; i < 30; i++) {
        assert_true(video_stream_next(f, 1280, 720, 1e6, 60, &shot));
        (void)video_stream_shown(f, i == 15 ? 0.06 : 0.03, 0.04, &told);
        assert_int_equal(shot.width_px, 1280);
    }
    for (int i = 0; i < 30; i++) { /* it takes what its pixels take */
        assert_true(video_stream_next(f, 1280, 720, 1e6, 60, &shot));
        (void)video_stream_shown(f, 0.2e-6 * shot.width_px * shot.height_px, 0.04, &told);
    }
    assert_true(shot.width_px < 700 && shot.width_px > 300);
    video_stream_drop(&f);
}

/* The time in which an encoder was opened says nothing about the next frames. */
static void test_opening_does_not_count(void **state)
{
    struct video_stream_room room = {.limit_bytes = SIZE_MAX, .threads = 1};
    struct video_stream_told told;
    struct video_stream_shot shot;
    struct buf out = {0};
    struct err e = {0};
    if (!video_can())
        skip();
    struct video_stream *f = video_stream_begin(&room);
    const size_t n = video_planes_bytes(640, 360);
    uint8_t *planes = mem_array(n, 1);
    assert_non_null(planes);
    for (int i = 0; i < 2; i++) {
        assert_true(video_stream_next(f, 640, 360, 1e6, 60, &shot));
        assert_int_equal(shot.width_px, 640);
        kit_ok(video_stream_encode(f, &shot, planes, n, &out, &e), e);
        const double area = video_stream_shown(f, 1, 0.04, &told);
        assert_int_equal(told.key, i == 0);
        assert_int_equal(told.quantizer, shot.quantizer);
        assert_true(i ? area < 640 * 360 / 2 : area == 640 * 360);
    }
    mem_free(planes);
    buf_free(&out);
    video_stream_drop(&f);
}

/* ---- planes ---- */

static void test_planes(void **state)
{
    enum { WIDE = 5, HIGH = 3 };
    struct err e = {0};
    struct image img;
    uint8_t planes[WIDE * HIGH + 2 * 3 * 2];
    static const struct {
        uint8_t rgb[3], yuv[3];
    } known[] = {/* BT.709, narrow range */
                 {{0, 0, 0}, {16, 128, 128}},   {{255, 255, 255}, {235, 128, 128}},
                 {{255, 0, 0}, {63, 102, 240}}, {{0, 255, 0}, {173, 42, 26}},
                 {{0, 0, 255}, {32, 240, 118}}, {{128, 128, 128}, {126, 128, 128}}};
    kit_ok(image_alloc(WIDE, HIGH, 3, &img, &e), e);
    assert_int_equal(video_planes_bytes(WIDE, HIGH), sizeof planes);
    for (size_t k = 0; k < sizeof known / sizeof *known; k++) {
        for (size_t i = 0; i < (size_t)WIDE * HIGH; i++)
            memcpy(img.px + 3 * i, known[k].rgb, 3);
        video_planes(&img, planes);
        for (size_t i = 0; i < sizeof planes; i++)
            assert_int_equal(planes[i], known[k].yuv[i < WIDE * HIGH       ? 0
                                                     : i < WIDE * HIGH + 6 ? 1
                                                                           : 2]);
    }
    image_free(&img);
}

/* ---- a reader that decodes ---- */

struct watcher {
    struct reader r;
    struct video_decoder *decoder;
    struct image frame; /* the newest */
    int frames, keys;
};

static void client_watch_open(struct watcher *w, const char *target)
{
    struct err e = {0};
    memset(w, 0, sizeof *w);
    reader_open(&w->r, target);
    kit_ok(video_decoder_open(&w->decoder, &e), e);
}

static void client_watch_close(struct watcher *w)
{
    reader_close(&w->r);
    video_decoder_close(&w->decoder);
    image_free(&w->frame);
}

/* The next part. A frame is decoded, and is of the size that the part's head says. */
static bool watch_next(struct watcher *w, double wait_s, struct part *p)
{
    struct err e = {0};
    if (!reader_next(&w->r, wait_s, p))
        return false;
    if (strcmp(p->type, MULTIPART_FRAME_TYPE) != 0)
        return true;
    kit_ok(video_decode(w->decoder, w->r.body.data + p->at, p->bytes, &w->frame, &e), e);
    assert_int_equal(w->frame.width_px, p->width);
    assert_int_equal(w->frame.height_px, p->height);
    w->frames++;
    w->keys += p->key;
    return true;
}

/* The picture of /render from a heading. */
static void drawn(double heading, unsigned width, unsigned height, struct image *out)
{
    struct err e = {0};
    struct buf body = {0}, q = {0};
    struct reply a;
    char path[FILE_PATH_MAX];
    buf_printf(&body,
               "{\"pose\":{\"lon\":13.398,\"lat\":52.4985,\"height\":150,\"heading\":%.3f,"
               "\"pitch\":-40,\"fov\":55},\"width\":%u,\"height\":%u,\"format\":\"png\","
               "\"supersample\":1}",
               heading, width, height);
    buf_printf(
        &q, "POST /d/toy/render HTTP/1.1\r\n" H "Connection: close\r\nContent-Length: %zu\r\n\r\n",
        body.size);
    buf_add(&q, body.data, body.size);
    int fd = dial(t.port);
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, true, NULL, &a);
    close(fd);
    assert_int_equal(a.status, 200);
    kit_ok(file_join(path, t.dir, "drawn.png", &e), e);
    kit_ok(file_write(path, a.body, a.body_size, &e), e);
    kit_ok(image_read(path, NULL, out, &e), e);
    buf_free(&a.raw);
    buf_free(&q);
    buf_free(&body);
}

/* SSIM of the newest frame against /render from a heading. */
static double likeness(const struct watcher *w, const struct part *p, double heading)
{
    struct err e = {0};
    struct image img;
    double ssim;
    const size_t n = (size_t)p->width * p->height * 3;
    float *rgb = mem_array(n, sizeof *rgb);
    assert_non_null(rgb);
    for (size_t i = 0; i < n; i++)
        rgb[i] = (float)w->frame.px[i] / 255.0f;
    drawn(heading, p->width, p->height, &img);
    kit_ok(metric_ssim(rgb, img.px, NULL, p->width, p->height, METRIC_VALID, &ssim, &e), e);
    image_free(&img);
    mem_free(rgb);
    return ssim;
}

/* ---- streams ---- */

static void watch_begin(struct watcher *w)
{
    if (!video_can())
        skip();
    start_drawing();
    client_watch_open(w, VIDEO);
    await_streams(1);
}

/* The camera turns, and whatever comes is decoded; *p: the last frame. */
static void turn(struct watcher *w, int from, int to, int width, struct part *p)
{
    struct part got;
    memset(p, 0, sizeof *p);
    for (int i = from; i <= to; i++) {
        assert_int_equal(steer(NAME, i, i, width, ""), 204);
        for (double end_s = clock_s() + PATIENCE_S; clock_s() < end_s;) {
            if (!watch_next(w, 0.05, &got))
                break;
            if (got.key >= 0)
                *p = got;
        }
        while (!p->bytes && watch_next(w, PATIENCE_S, &got))
            if (got.key >= 0)
                *p = got;
    }
}

static void test_frames_are_what_is_drawn(void **state)
{
    struct watcher w;
    struct part p, rest = {0};
    watch_begin(&w);
    turn(&w, 1, 20, 640, &p);
    assert_true(w.frames >= 2 && p.key >= 0);
    assert_in_range(p.quantizer, 22, 54);
    assert_true(w.keys >= 1 && w.keys < w.frames); /* the first, and one where the size changes */
    const double same = likeness(&w, &p, (double)p.pose),
                 other = likeness(&w, &p, (double)p.pose + 20);
    print_message("%d frames, %d of them key frames; SSIM %.4f, of another camera %.4f\n", w.frames,
                  w.keys, same, other);
    assert_true(same > 0.9 && same > other + 0.05);
    while (!rest.rest && watch_next(&w, PATIENCE_S, &rest))
        continue;
    assert_string_equal(rest.type, "image/jpeg"); /* in the end it is sharp, and in full */
    assert_int_equal(rest.width, 640);
    assert_int_equal(rest.pose, 20);
    /* the process that draws ends, but not the video */
    struct worker_status st;
    picture_status(server_services(t.server)->picture, &st);
    kill(st.pid, SIGKILL);
    turn(&w, 30, 36, 640, &p);
    assert_true(p.pose >= 30 && likeness(&w, &p, (double)p.pose) > 0.9);
    /* a reader that lost its way asks for a key frame */
    assert_int_equal(steer(NAME, 50, 50, 640, ",\"key\":true"), 204);
    do
        assert_true(watch_next(&w, PATIENCE_S, &p));
    while (p.pose != 50);
    assert_int_equal(p.key, 1);
    assert_int_equal(counts().encoders, 1);
    assert_true(counts().encoder_bytes > 0 && counts().frames >= (uint64_t)w.frames);
    client_watch_close(&w);
    await_streams(0);
    kit_await(!counts().encoders && !counts().encoder_bytes);
}

/* Steers as long as that makes frames. The result is the number of the last camera. */
static int steer_until_nothing_comes(int number, const char *more)
{
    const double end_s = clock_s() + PATIENCE_S;
    const uint64_t first = counts().frames;
    uint64_t seen = first;
    double seen_s = clock_s();
    while ((seen == first || clock_s() - seen_s < 1) && clock_s() < end_s) {
        number++;
        assert_int_equal(steer(NAME, number, number % 360, 1200, more), 204);
        nap_ms(5);
        if (counts().frames != seen) {
            seen = counts().frames;
            seen_s = clock_s();
        }
    }
    assert_true(clock_s() < end_s);
    return number;
}

/* A reader that does not read gets no more frames than the sockets hold, and then at once the
 * newest: what it does not take is not encoded. */
static void test_slow_reader(void **state)
{
    enum { HELD_BYTES = 96 << 10 };
    struct watcher w;
    struct part p;
    watch_begin(&w);
    turn(&w, 1, 2, 1200, &p);
    const size_t before = w.r.raw.size;
    const uint64_t frames = counts().frames;
    const int last = steer_until_nothing_comes(2, ",\"key\":true");
    const uint64_t encoded = counts().frames - frames;
    assert_true(encoded >= 1 && encoded < (uint64_t)last - 2);
    do
        assert_true(watch_next(&w, PATIENCE_S, &p)); /* they decode, one after the other */
    while (p.pose < last);
    assert_true(w.r.raw.size - before < HELD_BYTES);
    assert_true(counts().frames - frames - encoded <= 2); /* the newest, and one on its way */
    print_message("%d cameras, %d frames of %zu bytes\n", last - 2, (int)encoded,
                  w.r.raw.size - before);
    client_watch_close(&w);
    await_streams(0);
}

/* A build without libvpx: the same request is answered with JPEG. */
static void test_without_an_encoder(void **state)
{
    struct reader r;
    struct part p;
    if (video_can())
        skip();
    start_drawing();
    reader_open(&r, VIDEO);
    await_streams(1);
    assert_int_equal(steer(NAME, 1, 10, 640, ""), 204);
    assert_true(reader_next(&r, PATIENCE_S, &p));
    assert_string_equal(p.type, "image/jpeg");
    reader_close(&r);
}

static void test_refusals(void **state)
{
    struct reply a;
    t.cfg.device = "none";
    start();
    ask("GET", "/d/toy/motion/0123456789abcdef?video=h264", "", &a);
    assert_int_equal(a.status, 400);
    assert_non_null(strstr((const char *)a.body, "video is vp9, or left out for JPEG"));
    buf_free(&a.raw);
    assert_int_equal(status_of("HEAD", "/d/toy/motion/0123456789abcdef?video=", ""), 400);
    assert_int_equal(status_of("HEAD", "/d/toy/motion/0123456789abcdef?video=vp9", ""), 503);
}

int main(int argc, char **argv)
{
    if (worker_asked(argc, argv))
        return draw_main();
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_memory_for_encoders),
        cmocka_unit_test(test_quality_follows_the_line),
        cmocka_unit_test(test_size_follows_the_time),
        cmocka_unit_test(test_opening_does_not_count),
        cmocka_unit_test(test_planes),
        HTTP_TEST(test_frames_are_what_is_drawn),
        HTTP_TEST(test_slow_reader),
        HTTP_TEST(test_without_an_encoder),
        HTTP_TEST(test_refusals),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
