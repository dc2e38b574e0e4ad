/* Pictures over HTTP, on any OpenCL device: the bytes are those of the view, each is made once,
 * newer ones go first, and tiles are still answered meanwhile.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/image/image.h"
#include "lod/choose/pick.h"
#include "lod/choose/view.h"
#include "render/render.h"
#include "tests/server/client.h"

static const char POSE[] = "13.398,52.4985,150@10.5,-40,55";

static const char *view_target(const char *pose, const char *size, char out[256])
{
    snprintf(out, 256, "/d/toy/r/%s/static/%s/%s", revision_of(EDITION_PICTURES), pose, size);
    return out;
}

/* The same view, made without a server. */
static void draw(struct buf *out)
{
    struct err e = {0};
    struct dev dev;
    struct render *r = NULL;
    struct view *v = NULL;
    struct image img = {0};
    struct camera cam;
    static float rgb[96 * 64 * 3];
    const struct view_pose pose = {13.398, 52.4985, 150, 10.5, -40, 55};
    const struct render_options ro = {.aa = RENDER_AA_NONE, .sh_degree = -1};
    kit_ok(dev_open("cpu", &dev, &e), e);
    kit_ok(render_open(&dev, &r, &e), e);
    kit_ok(view_open(t.path, r, 1 << 28, &v, &e), e);
    kit_ok(view_camera(&served_origin, &pose, 96, 64, &cam, &e), e);
    kit_ok(view_render(v, &cam, &ro, &(struct pick_options){0}, rgb, NULL, &e), e);
    kit_ok(image_alloc(96, 64, 3, &img, &e), e);
    size_t lit = 0;
    for (size_t i = 0; i < 96 * 64 * 3; i++) {
        float b = rgb[i] * 255.0f + 0.5f;
        img.px[i] = b >= 255 ? 255 : (uint8_t)b;
        lit += img.px[i] > 20;
    }
    assert_true(lit > 1000); /* there is something to see */
    kit_ok(image_encode(&img, "png", 85, out, &e), e);
    image_free(&img);
    view_close(&v);
    render_close(&r);
    dev_close(&dev);
}

static void test_bytes(void **state)
{
    struct reply r;
    struct buf want = {0};
    char target[256], etag[64], line[128];
    if (!start_with_device())
        skip();
    draw(&want);
    view_target(POSE, "32x32.png", target); /* the device is ready once one was drawn */
    assert_int_equal(status_of("GET", target, ""), 200);
    ask("GET", view_target(POSE, "96x64.png", target), "", &r);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Content-Type"), "image/png");
    assert_string_equal(header(&r, "Cache-Control"), "public, max-age=31536000, immutable");
    assert_true(strlen(header(&r, "Server-Timing")) > 0);
    assert_int_equal(r.body_size, want.size);
    assert_memory_equal(r.body, want.data, want.size);
    buf_free(&r.raw);

    ask("GET", target, "", &r); /* from the cache; the entity tag is that of the ready device */
    assert_int_equal(r.status, 200);
    assert_memory_equal(r.body, want.data, want.size);
    snprintf(etag, sizeof etag, "%s", header(&r, "ETag"));
    buf_free(&r.raw);
    snprintf(line, sizeof line, "If-None-Match: %s\r\n", etag);
    assert_int_equal(status_of("GET", target, line), 304);

    static const char body[] =
        "{\"pose\":{\"lon\":13.398,\"lat\":52.4985,\"height\":150,\"heading\":10.5,"
        "\"pitch\":-40,\"fov\":55},\"width\":96,\"height\":64,\"format\":\"png\"}";
    struct buf q = {0}; /* the same camera, posted */
    buf_printf(&q, POST "Connection: close\r\nContent-Length: %zu\r\n\r\n%s", sizeof body - 1,
               body);
    int fd = dial(t.port);
    say_bytes(fd, (char *)q.data, q.size);
    hear(fd, true, NULL, &r);
    close(fd);
    assert_int_equal(r.status, 200);
    assert_string_equal(header(&r, "Cache-Control"), "no-store");
    assert_string_equal(header(&r, "ETag"), "");
    assert_int_equal(r.body_size, want.size);
    assert_memory_equal(r.body, want.data, want.size);
    buf_free(&r.raw);
    buf_free(&q);
    buf_free(&want);

    ask("GET", view_target(POSE, "96x64.jpg", target), "", &r);
    assert_int_equal(r.status, 200);
    assert_memory_equal(r.body, "\xff\xd8\xff", 3);
    buf_free(&r.raw);
    ask("GET", view_target(POSE, "96x64.webp", target), "", &r);
    assert_int_equal(r.status, 200);
    assert_memory_equal(r.body, "RIFF", 4);
    buf_free(&r.raw);
    ask("GET", "/version", "", &r);
    assert_non_null(strstr((const char *)r.body, "\"ready\""));
    buf_free(&r.raw);
}

/* Many clients, one camera: one picture. Many cameras: as many as fit, the rest is told to come
 * back, and nobody is left without an answer. */
static void test_crowd(void **state)
{
    enum { CLIENTS = 40 };
    int fd[CLIENTS];
    struct job_stats st;
    char target[256], request[400];
    struct reply r;
    if (!start_with_device())
        skip();
    struct services *s = server_services(t.server);
    ask("GET", view_target(POSE, "32x32.png", target), "",
        &r); /* the device is ready from here on */
    buf_free(&r.raw);
    for (int round = 0; round < 2; round++) {
        for (int i = 0; i < CLIENTS; i++) {
            char pose[96];
            snprintf(pose, sizeof pose, "13.398,52.4985,150@%d,-40", round ? i : 77);
            snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
                     view_target(pose, "200x150.jpg", target));
            fd[i] = dial(t.port);
            say(fd[i], request);
        }
        assert_int_equal(status_of("GET", tile_target(17, "glb", target), ""), 200);
        int ok = 0, later = 0;
        for (int i = 0; i < CLIENTS; i++) {
            hear(fd[i], true, NULL, &r);
            ok += r.status == 200;
            /* 429: newer pictures of the same client took the place of this one */
            later += (r.status == 503 || r.status == 429) && atoi(header(&r, "Retry-After")) >= 1;
            buf_free(&r.raw);
            close(fd[i]);
        }
        assert_int_equal(ok + later, CLIENTS);
        job_count(s->jobs, &st);
        if (round == 0) {
            assert_int_equal(ok, CLIENTS);
            assert_in_range(st.ended[JOB_VIEW][JOB_OK], 2,
                            3); /* 3: one came between end and cache */
        } else {
            assert_true(ok >= 1);
            assert_int_equal(st.ended[JOB_VIEW][JOB_SHED], later);
        }
    }
}

/* Whoever hangs up takes the queued picture along. */
static void test_gone_clients(void **state)
{
    enum { CLIENTS = 8 };
    int fd[CLIENTS];
    struct job_stats st;
    char target[256], request[400];
    if (!start_with_device())
        skip();
    struct services *s = server_services(t.server);
    for (int i = 0; i < CLIENTS;
         i++) { /* while the device starts, or one is drawn, the others wait */
        char pose[96];
        snprintf(pose, sizeof pose, "13.398,52.4985,150@%d,-40", i);
        snprintf(request, sizeof request, "GET %s HTTP/1.1\r\n" H "\r\n",
                 view_target(pose, "500x400.jpg", target));
        fd[i] = dial(t.port);
        say(fd[i], request);
    }
    kit_await((job_count(s->jobs, &st),
               st.queued[JOB_VIEW] + st.running[JOB_VIEW] + st.ended[JOB_VIEW][JOB_OK] == CLIENTS));
    for (int i = 0; i < CLIENTS; i++)
        close(fd[i]);
    await_no_connections();
    kit_await(job_idle(s->jobs));
    job_count(s->jobs, &st);
    assert_true(st.ended[JOB_VIEW][JOB_CANCELLED] >= 1);
    assert_int_equal(st.ended[JOB_VIEW][JOB_OK] + st.ended[JOB_VIEW][JOB_CANCELLED], CLIENTS);
    assert_int_equal(status_of("GET", view_target(POSE, "32x32.png", target), ""), 200);
}

/* After a reload, pictures of the revision before are drawn, although its file is gone: nothing of
 * it was drawn before. */
static void test_pictures_of_an_older_revision(void **state)
{
    struct err e = {0};
    struct reply r;
    struct buf want = {0};
    char path[FILE_PATH_MAX], target[256], old[13];
    kit_ok(file_join(path, t.dir, "moving.tiles", &e), e);
    served_city(path, "toy", 2000);
    t.paths[0] = path;
    bool there = start_with_device();
    if (!there)
        skip();
    draw(&want);
    memcpy(old, t.rev, sizeof old);
    assert_int_equal(unlink(path), 0);
    served_city(path, "toy", 500);
    kit_ok(server_reload(t.server, &e), e);
    t.paths[0] = t.path;
    ask("GET", view_target(POSE, "96x64.png", target), "", &r);
    assert_int_equal(r.status, 200);
    assert_int_equal(r.body_size, want.size);
    assert_memory_equal(r.body, want.data, want.size);
    buf_free(&r.raw);
    struct catalog *c = services_catalog(server_services(t.server));
    memcpy(t.rev, c->ds[0]->meta.revision, sizeof t.rev);
    catalog_drop(&c);
    assert_string_not_equal(old, t.rev);
    ask("GET", view_target(POSE, "96x64.png", target), "", &r);
    assert_int_equal(r.status, 200);
    assert_true(r.body_size != want.size || memcmp(r.body, want.data, want.size) != 0);
    buf_free(&r.raw);
    buf_free(&want);
}

/* A file that was damaged, and restored with the same bytes, is drawn after a reload, and no view
 * keeps the descriptor of the damaged one. */
static void test_pictures_of_a_restored_file(void **state)
{
    struct err e = {0};
    struct reply r;
    struct buf links = {0};
    char path[FILE_PATH_MAX], good[FILE_PATH_MAX], target[256];
    kit_ok(file_join(path, t.dir, "restored.tiles", &e), e);
    kit_ok(file_join(good, t.dir, "good.tiles", &e), e);
    served_city(path, "toy", 2000);
    assert_int_equal(kit_run(&links, "cp '%s' '%s'", path, good), 0);
    for (int z = SERVED_ZOOM_MIN; z <= SERVED_ZOOM_MAX; z++)
        store_fixture_damage(path, served_key((uint8_t)z), path);
    t.paths[0] = path;
    bool there = start_with_device();
    if (!there)
        skip();
    assert_int_equal(status_of("GET", view_target(POSE, "96x64.png", target), ""), 500);
    assert_int_equal(rename(good, path), 0);
    kit_ok(server_reload(t.server, &e), e);
    t.paths[0] = t.path;
    assert_int_equal(status_of("GET", view_target(POSE, "96x64.png", target), ""), 200);
    ask("GET", "/readyz", "", &r);
    buf_add(&r.raw, "", 1);
    assert_null(strstr((const char *)r.body, "degraded"));
    buf_free(&r.raw);
    buf_free(&links);
    assert_int_equal(
        kit_run(&links, "ls -l /proc/%d/fd | grep -c 'restored.tiles (deleted)'", (int)getpid()),
        1);
    buf_free(&links);
}

int main(int argc, char **argv)
{
    if (worker_asked(argc, argv))
        return draw_main();
    const struct CMUnitTest tests[] = {
        HTTP_TEST(test_bytes),
        HTTP_TEST(test_crowd),
        HTTP_TEST(test_gone_clients),
        HTTP_TEST(test_pictures_of_an_older_revision),
        HTTP_TEST(test_pictures_of_a_restored_file),
    };
    return cmocka_run_group_tests(tests, setup_all, teardown_all);
}
