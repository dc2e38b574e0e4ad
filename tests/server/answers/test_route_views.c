/* Pictures as pure calls: what each address and each posted camera becomes, and what is in its tag.
 * Nothing is drawn.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/quant.h"
#include "lod/choose/view.h"
#include "server/answers/answer_view.h"
#include "server/documents/result_id.h"
#include "server/drawing/picture_id.h"
#include "tests/server/routed.h"

#include <math.h>

static void test_views(void **state)
{
    const char *target = "/d/toy/r/REV/static/13.4,52.5,120@0,-90/64x48.jpg";
    struct err e = {0};
    struct response r = get(target);
    assert_int_equal(r.status, 503); /* --device none */
    assert_true(says(&r, "--device none"));
    assert_int_equal(r.retry_after_s, 0); /* waiting does not help */
    response_free(&r);
    kit_ok(picture_open(&t.cfg, &t.s.plan, &t.s.picture, &e), e); /* as while the device starts */
    r = get(target);
    assert_non_null(r.work);
    assert_int_equal(r.cls, JOB_VIEW);
    response_free(&r);
    r = answer(&(struct ask){.target = target, .prefetch = true});
    assert_non_null(r.work);
    assert_int_equal(r.cls, JOB_AHEAD);
    assert_ptr_equal(r.work->kind, &answer_view_work);
    const struct camera *cam = &((const struct answer_view_own *)work_own(r.work))->view.cam;
    assert_int_equal(cam->width_px, 64);
    struct camera want;
    const struct view_pose pose = {13.4, 52.5, 120, 0, -90, 60};
    kit_ok(view_camera(&served_origin, &pose, 64, 48, &want, &e), e);
    for (int i = 0; i < 9; i++)
        assert_true(fabs(cam->rot[i] - want.rot[i]) < 1e-12);
    response_free(&r);
    r = get("/d/toy/r/REV/static/13.4,52.5,120@0,-90/4000x48.jpg");
    assert_int_equal(r.status, 422);
    response_free(&r);
    r = get("/d/toy/r/REV/static/13.4,52.5,120@0,-90/0x48.jpg");
    assert_int_equal(r.status, 422);
    response_free(&r);
    picture_close(&t.s.picture);
}

/* What is behind a picture, its depth, its roll and its scale are in the address and in the tag:
 * what makes other bytes has another tag, what does not has the same. */
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
        {AT "/64x48.png?supersample=2", AT "/64x48.png", false},
        {AT "/64x48.png?supersample=2", AT "/64x48.png?supersample=1", false},
        {AT "/64x48.npy?supersample=2", AT "/64x48.npy", true},
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
        {AT "/64x48.png?supersample=0", 400},
        {AT "/1200x1000.png?supersample=4", 422},
        {AT "/64x48.png?supersample=5", 400},
        {AT "/64x48.png?supersample=", 400},
        {AT "/64x48.png?supersample=2&supersample=2", 400},
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
    kit_ok(picture_open(&t.cfg, &t.s.plan, &t.s.picture, &e), e);
    for (size_t i = 0; i < sizeof equal / sizeof *equal; i++) {
        struct response a = get(equal[i].a), b = get(equal[i].b);
        assert_non_null(a.work);
        assert_non_null(b.work);
        char tag_a[BODY_ETAG_SIZE], tag_b[BODY_ETAG_SIZE]; /* of the device that starts: not sent */
        body_etag(a.work->id, tag_a);
        body_etag(b.work->id, tag_b);
        if (!strcmp(tag_a, tag_b) != equal[i].same)
            fail_msg("%s and %s: tags %s and %s", equal[i].a, equal[i].b, tag_a, tag_b);
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

/* The same address of two servers that differ in what they were told. */
static void two_answers(const char *target, const struct server_config *other,
                        struct catalog *others, struct response *a, struct response *b)
{
    const struct server_config *usual = t.s.cfg;
    struct catalog *usuals = t.s.catalog;
    const struct request r = {.target = target, .target_size = strlen(target)};
    dispatch_answer(&t.s, &r, a);
    t.s.cfg = other;
    t.s.catalog = others;
    dispatch_answer(&t.s, &r, b);
    t.s.cfg = usual;
    t.s.catalog = usuals;
}

/* Of the versions that drew one sky in every light: what they kept on disk is not found. */
static void test_pictures_of_before(void **state)
{
    static const char device[] = "one";
    const struct dataset *d = t.s.catalog->ds[0];
    const struct appearance_choice plain = {0};
    const struct draw_view view = {0};
    struct {
        struct hash128 salt;
        char device[160];
        double quality, supersample, gaussians;
    } edition = {.salt = d->salt, .device = "one", .quality = 85, .gaussians = 1000};
    struct {
        struct hash128 salt;
        char rev[16], device[160];
        double rot[9], trans[3], focal[4], gaussians;
        uint32_t numbers[9];
    } name;
    char was[9], is[9];
    memset(&name, 0, sizeof name);
    name.salt = d->salt;
    memcpy(name.rev, d->meta.revision, sizeof d->meta.revision);
    memcpy(name.device, device, sizeof device);
    name.gaussians = 1000;
    result_id_edition(&edition, sizeof edition, was);
    picture_id_edition(d, device, 85, 0, 1000, is);
    assert_string_not_equal(is, was);
    const struct hash128 old = hash_bytes(&name, sizeof name),
                         now = picture_id_view(d, device, &view, &plain, 1000);
    assert_true(old.lo != now.lo && old.hi != now.hi);
}

/* What a server is configured with is in the tag and in the edition: an address is immutable at the
 * server alone whose edition it names, since another answers it with other bytes. */
static void test_configuration_and_tags(void **state)
{
    struct server_config other = *t.s.cfg;
    struct catalog_options stores = served_stores;
    struct catalog *others = NULL;
    struct response a = {0}, b = {0};
    char target[256], device[9], tiles[9], edition[9];
    const char *paths[] = {t.path};
    const struct key k = served_key(17);
    other.view_gaussians = 1000;
    stores.preset = other.preset = QUANT_PREVIEW;
    others = served_catalog(paths, 1, &stores, NULL);
    const struct dataset *d = t.s.catalog->ds[0];
    response_edition(&t.s, d, EDITION_TILES, tiles);
    assert_int_equal(strlen(tiles), 8);
    for (int i = 0; i < 3; i++) { /* not said, its own, another one's */
        const char *names[] = {"", tiles, others->ds[0]->edition};
        snprintf(target, sizeof target, "/d/toy/r/%s%s%s/t/%u/%u/%u.spz", t.rev, i ? "-" : "",
                 names[i], k.z, k.x, k.y);
        two_answers(target, &other, others, &a, &b);
        assert_string_not_equal(a.etag, b.etag);
        expect("Cache-Control", a.cache_control, i == 1 ? IMMUTABLE : MOVING);
        expect("Cache-Control", b.cache_control, i == 2 ? IMMUTABLE : MOVING);
        response_free(&a);
        response_free(&b);
    }
    catalog_drop(&others);
    picture_id_edition(d, "one", 85, 0, 1000, device);
    picture_id_edition(d, "two", 85, 0, 1000, edition);
    assert_string_not_equal(device, edition);
    picture_id_edition(d, "one", 86, 0, 1000, edition);
    assert_string_not_equal(device, edition);
    picture_id_edition(d, "one", 85, 1, 1000, edition);
    assert_string_not_equal(device, edition);
    picture_id_edition(d, "one", 85, 0, 1001, edition);
    assert_string_not_equal(device, edition);
}

/* A picture that is asked for while the device starts has no name, since the device is part of
 * it. */
static void test_pictures_while_the_device_starts(void **state)
{
    struct err e = {0};
    char target[256], edition[9];
    kit_ok(picture_open(t.s.cfg, &t.s.plan, &t.s.picture, &e), e);
    response_edition(&t.s, t.s.catalog->ds[0], EDITION_PICTURES, edition);
    assert_string_equal(edition, "");
    snprintf(target, sizeof target, "/d/toy/r/%s/static/13.4,52.5,120@0,-90/64x48.png", t.rev);
    struct response a = answer(&(struct ask){.target = target, .if_none_match = "*"});
    assert_non_null(a.work);
    assert_false(a.work->keep);
    assert_string_equal(a.etag, "");
    expect("Cache-Control", a.cache_control, "no-store");
    response_free(&a);
    a = get("/d/toy/static/13.4,52.5,120@0,-90/64x48.png");
    char want[256];
    expect("Location", a.location,
           expand("../../r/REV/static/13.4,52.5,120@0,-90/64x48.png", want, sizeof want));
    response_free(&a);
    picture_close(&t.s.picture);
}

static void test_foreign_bytes_in_a_redirect(void **state)
{
    struct response r = get("/d/toy/t/17/1/1.glb?x=%0d%0a"); /* encoded bytes stay encoded */
    assert_int_equal(r.status, 307);
    assert_null(strpbrk(r.location, "\r\n"));
    response_free(&r);
    static const char bad[] = "/d/toy/t/17/1/1.glb?x=\r\nSet-Cookie:a";
    struct request q = {.target = bad, .target_size = sizeof bad - 1};
    dispatch_answer(&t.s, &q, &r);
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
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"deadline_ms\":15000}",
         0},
        {"{\"pose\":{\"lon\":13,\"lat\":52,\"height\":1,\"heading\":0,\"pitch\":0},\"width\":64,"
         "\"height\":48,\"deadline_ms\":15001}", /* more than --deadline-s */
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
    kit_ok(picture_open(&t.cfg, &t.s.plan, &t.s.picture, &e), e);
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
    /* a key that is none is named, and those that there are */
    r = answer(
        &(struct ask){.method = METHOD_POST, .target = "/d/toy/render", .body = "{\"shape\": 1}"});
    assert_int_equal(r.status, 422);
    kit_expect_text((const char *)r.data, "takes no 'shape'", __FILE__, __LINE__);
    kit_expect_text((const char *)r.data, "camera, pose, width, height, format, quality", __FILE__,
                    __LINE__);
    kit_expect_text((const char *)r.data, ", supersample", __FILE__, __LINE__);
    response_free(&r);
    picture_close(&t.s.picture);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_views),
        cmocka_unit_test(test_what_is_in_the_tag),
        cmocka_unit_test(test_configuration_and_tags),
        cmocka_unit_test(test_pictures_of_before),
        cmocka_unit_test(test_pictures_while_the_device_starts),
        cmocka_unit_test(test_foreign_bytes_in_a_redirect),
        cmocka_unit_test(test_posted_cameras),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
