/* Pictures as pure calls: what each address and each posted camera becomes, and what is in its tag. Nothing
 * is drawn.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lod/view.h"
#include "tests/routed.h"

#include <math.h>

static void test_views(void **state)
{
    const char *target = "/d/toy/r/REV/static/13.4,52.5,120@0,-90/64x48.jpg";
    struct err e = {0};
    (void)state;
    struct response r = get(target);
    assert_int_equal(r.status, 503); /* --device none */
    assert_true(says(&r, "--device none"));
    assert_in_range(r.retry_after_s, 1, 10);
    response_free(&r);
    kit_ok(picture_open(&t.cfg, &t.s.picture, &e), e); /* as while the device starts */
    r = get(target);
    assert_non_null(r.work);
    assert_int_equal(r.cls, JOB_VIEW);
    assert_int_equal(r.work->view.cam.width_px, 64);
    struct camera want;
    const struct view_pose pose = {13.4, 52.5, 120, 0, -90, 60};
    kit_ok(view_camera(&served_origin, &pose, 64, 48, &want, &e), e);
    for (int i = 0; i < 9; i++)
        assert_true(fabs(r.work->view.cam.rot[i] - want.rot[i]) < 1e-12);
    response_free(&r);
    r = get("/d/toy/r/REV/static/13.4,52.5,120@0,-90/4000x48.jpg");
    assert_int_equal(r.status, 422);
    response_free(&r);
    r = get("/d/toy/r/REV/static/13.4,52.5,120@0,-90/0x48.jpg");
    assert_int_equal(r.status, 422);
    response_free(&r);
    picture_close(&t.s.picture);
}

/* What is behind a picture, its depth, its roll and its scale are in the address and in the tag: what makes
 * other bytes has another tag, what does not has the same. */
static void test_what_is_in_the_tag(void **state)
{
#define AT "/d/toy/r/REV/static/13.4,52.5,120@0,-90"
    static const struct {
        const char *a, *b;
        bool same;
    } equal[] = {
        {AT "/64x48@2x.png", AT "/128x96.png", true},
        {AT "/64x48@1x.png", AT "/64x48.png", true},
        {AT ",60/64x48.png", AT ",60,0/64x48.png", true},
        {AT ",60,360/64x48.png", AT "/64x48.png", true},
        {AT ",60,-90/64x48.png", AT ",60,270/64x48.png", true},
        {AT ",60,1/64x48.png", AT "/64x48.png", false},
        {AT "/64x48.png?background=000000", AT "/64x48.png", true},
        {AT "/64x48.png?background=FF00aa", AT "/64x48.png?background=ff00AA", true},
        {AT "/64x48.png?background=ff0000", AT "/64x48.png", false},
        {AT "/64x48.png?background=sky", AT "/64x48.png", false},
        {AT "/64x48.png?background=transparent", AT "/64x48.png?background=sky", false},
        {AT "/64x48.png?depth=cm", AT "/64x48.png?depth=mm", false},
        {AT "/64x48.png?depth=cm", AT "/64x48.png", false},
        {AT "/64x48.npy", AT "/64x48.png", false},
        {AT "/64x48.png?v=1", AT "/64x48.png", true},
    };
    static const struct {
        const char *target;
        int status;
    } bad[] = {
        {AT "/64x48.jpg?background=transparent", 422},
        {AT "/64x48.jpg?depth=cm", 422},
        {AT "/64x48.npy?depth=cm", 422},
        {AT "/64x48.npy?background=sky", 422},
        {AT "/64x48.png?depth=cm&background=sky", 422},
        {AT "/64x48.png?background=red", 400},
        {AT "/64x48.png?background=ff000", 400},
        {AT "/64x48.png?background=ff00000", 400},
        {AT "/64x48.png?background=", 400},
        {AT "/64x48.png?depth=km", 400},
        {AT "/64x48.png?depth=1", 400},
        {AT "/64x48.png?depth=m&depth=m", 400},
        {AT "/64x48.png?background=sky&background=sky", 400},
        {AT "/64x48@0x.png", 400},
        {AT "/64x48@5x.png", 400},
        {AT "/64x48@2.png", 400},
        {AT "/64x48@2.5x.png", 400},
        {AT "/2000x2000@4x.png", 422},
        {AT "/999999999x999999999@4x.png", 422},
        {AT ",60,361/64x48.png", 422},
        {AT ",60,/64x48.png", 400},
        {AT ",60,0,0/64x48.png", 400},
        {AT "/64x48.exr", 400},
    };
#undef AT
    struct err e = {0};
    (void)state;
    kit_ok(picture_open(&t.cfg, &t.s.picture, &e), e);
    for (size_t i = 0; i < sizeof equal / sizeof *equal; i++) {
        struct response a = get(equal[i].a), b = get(equal[i].b);
        assert_non_null(a.work);
        assert_non_null(b.work);
        if (!strcmp(a.etag, b.etag) != equal[i].same)
            fail_msg("%s and %s: tags %s and %s", equal[i].a, equal[i].b, a.etag, b.etag);
        response_free(&a);
        response_free(&b);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        struct response r = get(bad[i].target);
        if (r.status != bad[i].status)
            fail_msg("%s: %d, want %d", bad[i].target, r.status, bad[i].status);
        response_free(&r);
    }
    picture_close(&t.s.picture);
}

/* What a server is configured with is in the tag, and an address whose bytes depend on more than the
 * program's defaults is not immutable. */
static void test_configuration_and_tags(void **state)
{
    static const char *const immutable = "public, max-age=31536000, immutable";
    struct err e = {0};
    struct server_config usual = *t.s.cfg, other = usual;
    char target[256];
    const struct key k = served_key(17);
    (void)state;
    kit_ok(picture_open(t.s.cfg, &t.s.picture, &e), e);
    other.view_gaussians = 1000;
    other.preset = QUANT_PREVIEW;
    for (int view = 0; view < 2; view++) {
        if (view)
            snprintf(target, sizeof target, "/d/toy/r/%s/static/13.4,52.5,120@0,-90/64x48.png",
                     t.rev);
        else
            snprintf(target, sizeof target, "/d/toy/r/%s/t/%u/%u/%u.spz", t.rev, k.z, k.x, k.y);
        struct request r = {.target = target, .target_size = strlen(target)};
        struct response a = {0}, b = {0};
        route_answer(&t.s, &r, &a);
        t.s.cfg = &other;
        route_answer(&t.s, &r, &b);
        t.s.cfg = &usual;
        assert_string_not_equal(a.etag, b.etag);
        assert_string_equal(a.cache_control, immutable);
        assert_string_not_equal(b.cache_control, immutable);
        response_free(&a);
        response_free(&b);
    }
    t.s.cfg = &t.cfg;
    picture_close(&t.s.picture);
    struct response r = get("/d/toy/t/17/1/1.glb?x=%0d%0a"); /* encoded bytes stay encoded */
    assert_int_equal(r.status, 307);
    assert_null(strpbrk(r.location, "\r\n"));
    response_free(&r);
    static const char bad[] = "/d/toy/t/17/1/1.glb?x=\r\nSet-Cookie:a";
    struct request q = {.target = bad, .target_size = sizeof bad - 1};
    route_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 400);
    response_free(&r);
}

static void test_posted_cameras(void **state)
{
    static const struct {
        const char *body;
        int status; /* 0: becomes a job */
    } rows[] = {
        {"{\"pose\":{\"lon\":13.4,\"lat\":52.5,\"height\":120,\"heading\":0,\"pitch\":-45},"
         "\"width\":64,\"height\":48}",
         0},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":50,\"cx\":32,\"cy\":24,\"world_"
         "to_camera\":"
         "[1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,0,1]},\"format\":\"png\",\"deadline_ms\":900}",
         0},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0,\"roll\":9},"
         "\"width\":64,"
         "\"height\":48,\"format\":\"png\",\"background\":\"transparent\"}",
         0},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"format\":\"png\",\"depth\":\"cm\"}",
         0},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"background\":\"transparent\"}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"depth\":7}",
         422},
        {"", 400},
        {"{", 400},
        {"[]", 400},
        {"{\"a\":1,\"a\":2}", 400},
        {"{\"pose\":1e999}", 400},
        {"{}", 422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":1e308,\"fy\":50,\"cx\":32,\"cy\":24,"
         "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":1e-308,\"cx\":32,\"cy\":24,"
         "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":50,\"cx\":1e300,\"cy\":24,"
         "\"world_to_camera\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{\"width\":64,\"height\":48,\"fx\":50,\"fy\":50,\"cx\":32,\"cy\":24,\"world_"
         "to_camera\":[1,0,0,1e300,0,1,0,0,0,0,1,0,0,0,0,1]}}",
         422},
        {"{\"camera\":{}}", 422},
        {"{\"camera\":1}", 422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0}}", 422},
        {"{\"pose\":{\"lon\":13,\"lat\":92,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0,\"fov\":0},"
         "\"width\":64,\"height\":48}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":99999}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0,\"tilt\":1},"
         "\"width\":64,\"height\":48}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"format\":\"gif\"}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"quality\":101}",
         422},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64.5,"
         "\"height\":48}",
         422},
    };
    struct err e = {0};
    (void)state;
    kit_ok(picture_open(&t.cfg, &t.s.picture, &e), e);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = answer(
            &(struct ask){.method = METHOD_POST, .target = "/d/toy/render", .body = rows[i].body});
        if ((r.work ? 0 : r.status) != rows[i].status)
            fail_msg("%s: got %d (%.*s)", rows[i].body, r.status, (int)r.size,
                     (const char *)r.data);
        expect("Cache-Control", r.cache_control, "no-store");
        if (r.work)
            assert_false(r.work->keep);
        response_free(&r);
    }
    struct buf deep = {0};
    for (int i = 0; i < 30000; i++)
        buf_add(&deep, "[", 1);
    buf_add(&deep, "", 1);
    struct response r = answer(&(struct ask){
        .method = METHOD_POST, .target = "/d/toy/render", .body = (const char *)deep.data});
    assert_int_equal(r.status, 400);
    response_free(&r);
    buf_free(&deep);
    picture_close(&t.s.picture);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_views),
        cmocka_unit_test(test_what_is_in_the_tag),
        cmocka_unit_test(test_configuration_and_tags),
        cmocka_unit_test(test_posted_cameras),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
