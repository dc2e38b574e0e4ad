/* The appearance API: the list, one appearance, blends, posted mixes, and tiles, tilesets and
 * prefetch lists in one. Requests are pure calls; jobs are run by the test itself.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/draco.h"
#include "codec/splat/ply.h"
#include "codec/splat/quant.h"
#include "core/pool.h"
#include "lod/store/photograph.h"
#include "tests/server/lit.h"

#include <jansson.h>
#include <math.h>

enum { PHOTOS = 6, LEN = 4, IMAGE = 13 };
static const char ODD_NAME[] = "roof 50%&=+\u00e9.jpg"; /* all of it has to be escaped */

static struct {
    char dir[FILE_PATH_MAX], lit[FILE_PATH_MAX], plain[FILE_PATH_MAX];
    struct appearance model; /* with the default one */
    struct arena arena;
    struct server_config cfg;
    struct services s;
} t;

static enum err_code no_run(void *user, const struct job *j, void *work, size_t worker,
                            struct body **out, struct err *e)
{
    (void)user, (void)j, (void)work, (void)worker, (void)out;
    return err_set(e, ERR_INTERNAL, "the test runs jobs itself");
}

static const uint8_t JPEG[] = {0xff, 0xd8, 0xff, 0xe0, 1, 2, 3, 4, 5};

/* What `tile` keeps of a photograph, for one of them. */
static void put_photograph(struct store *s)
{
    struct err e = {0};
    struct buf about = {0};
    char blob[PHOTOGRAPH_NAME_MAX];
    const struct photograph p = {.time = "2024-06-01T10:00:03",
                                 .lon_deg = 7.5,
                                 .lat_deg = -47.25,
                                 .h_m = 300.5,
                                 .heading_deg = 359.5,
                                 .pitch_deg = -45,
                                 .fov_y_deg = 50,
                                 .has_thumbnail = true};
    kit_ok(photograph_write(&p, &about, &e), e);
    kit_ok(photograph_blob(PHOTOGRAPH_BLOB, ODD_NAME, blob, &e), e);
    kit_ok(store_put_blob(s, blob, about.data, about.size, &e), e);
    kit_ok(photograph_blob(PHOTOGRAPH_THUMBNAIL, ODD_NAME, blob, &e), e);
    kit_ok(store_put_blob(s, blob, JPEG, sizeof JPEG, &e), e);
    buf_free(&about);
}

/* The city under six photographs' light. */
static void light_city(void)
{
    struct err e = {0};
    struct appearance photos;
    kit_ok(appearance_alloc(&photos, LEN, IMAGE, 8, PHOTOS, &e), e);
    appearance_init(&photos, 5);
    for (size_t i = 0; i < PHOTOS; i++)
        snprintf(photos.names[i], APPEARANCE_NAME_MAX, "p%zu.jpg", i);
    snprintf(photos.names[3], APPEARANCE_NAME_MAX, "%s", ODD_NAME);
    lit_city(t.lit, "lit", &photos, put_photograph, &t.model);
    appearance_free(&photos);
}

static int setup(void **state)
{
    struct err e = {0};
    kit_tmpdir(t.dir);
    kit_ok(file_join(t.lit, t.dir, "lit.tiles", &e), e);
    kit_ok(file_join(t.plain, t.dir, "plain.tiles", &e), e);
    light_city();
    served_city(t.plain, "plain", 20);
    served_config(&t.cfg, &t.arena);
    kit_ok(services_open(&t.s, &t.cfg, NULL, ROUTES, ROUTES_COUNT, &e), e);
    const char *paths[] = {t.lit, t.plain};
    t.s.catalog = served_catalog(paths, 2, &served_stores, NULL);
    const struct job_config jobs = {.queue_limit = {1, 1, 1}, .run = no_run, .drop = work_drop};
    kit_ok(job_open(&jobs, &t.s.jobs, &e), e);
    return 0;
}

static int teardown(void **state)
{
    services_free(&t.s);
    arena_free(&t.arena);
    appearance_free(&t.model);
    kit_rmdir(t.dir);
    return 0;
}

static struct response ask(enum method method, const char *target, const char *body)
{
    const struct request r = {.method = method,
                              .target = target,
                              .target_size = strlen(target),
                              .body = body,
                              .body_size = body ? strlen(body) : 0,
                              .own_host = "localhost"};
    struct response out;
    dispatch_answer(&t.s, &r, &out);
    if (out.work) {
        struct err e = {0};
        struct work *w = out.work;
        struct job_result result = {.end = JOB_OK};
        out.work = NULL;
        result.code = work_run(&t.s, NULL, w, 0, &result.body, &e);
        if (result.code == ERR_NOENT) {
            result.end = JOB_ERROR;
            snprintf(result.msg, sizeof result.msg, "%.200s", e.msg);
        } else {
            kit_ok(result.code, e);
        }
        assert_true(!result.body || !w->kind->room || result.body->size <= work_room(w));
        work_drop(NULL, w);
        dispatch_finish(&t.s, &r, &result, &out);
    }
    return out;
}

static struct response get(const char *target, int status)
{
    struct response r = ask(METHOD_GET, target, NULL);
    if (r.status != status)
        fail_msg("%s: %d instead of %d: %.*s", target, r.status, status, (int)r.size,
                 (const char *)r.data);
    return r;
}

static json_t *json_of(struct response *r)
{
    json_error_t je;
    json_t *o = json_loadb((const char *)r->data, r->size, JSON_REJECT_DUPLICATES, &je);
    if (!o)
        fail_msg("not JSON: %s line %d", je.text, je.line);
    response_free(r);
    return o;
}

static json_t *get_json(const char *target)
{
    struct response r = get(target, 200);
    return json_of(&r);
}

static bool says(const struct response *r, const char *words)
{
    char *text = mem_array(r->size + 1, 1);
    assert_non_null(text);
    memcpy(text, r->data, r->size);
    bool found = strstr(text, words) != NULL;
    mem_free(text);
    return found;
}

static const char *text_of(const json_t *o, const char *key)
{
    const char *text = json_string_value(json_object_get(o, key));
    assert_non_null(text);
    return text;
}

static void embedding_of(const json_t *o, float out[IMAGE])
{
    const json_t *list = json_object_get(o, "embedding");
    assert_int_equal(json_array_size(list), IMAGE);
    for (size_t i = 0; i < IMAGE; i++)
        out[i] = (float)json_number_value(json_array_get(list, i));
}

/* sum of weights of unit embeddings, in double */
static void blend(const size_t *row, const double *weight, size_t n, double out[IMAGE])
{
    memset(out, 0, IMAGE * sizeof *out);
    for (size_t k = 0; k < n; k++) {
        float unit[APPEARANCE_IMAGE_MAX];
        bake_unit(&t.model, row[k], unit);
        for (size_t i = 0; i < IMAGE; i++)
            out[i] += weight[k] * (double)unit[i];
    }
}

static void assert_embedding(const json_t *o, const double want[IMAGE])
{
    float got[IMAGE];
    embedding_of(o, got);
    for (size_t i = 0; i < IMAGE; i++)
        assert_true(fabs((double)got[i] - want[i]) < 1e-6);
}

/* href of a link of an object, below the dataset's address */
static const char *href(const json_t *o, const char *rel, char out[2048])
{
    size_t i;
    json_t *link;
    json_array_foreach(json_object_get(o, "links"), i, link)
    {
        if (strcmp(text_of(link, "rel"), rel) != 0)
            continue;
        snprintf(out, 2048, "/d/lit/%s", text_of(link, "href"));
        return out;
    }
    fail_msg("no link %s", rel);
    return NULL;
}

/* They are the five nearest of all, the nearest first. */
static void assert_nearest(const json_t *found, const double want[IMAGE])
{
    enum { NEAREST = 5 };
    const json_t *near = json_object_get(found, "nearest");
    double length = 0, last = 2, told[NEAREST];
    assert_int_equal(json_array_size(near), NEAREST);
    for (size_t j = 0; j < IMAGE; j++)
        length += want[j] * want[j];
    for (size_t k = 0; k < NEAREST; k++) {
        told[k] = json_number_value(json_object_get(json_array_get(near, k), "cosine"));
        assert_true(told[k] <= last);
        last = told[k];
    }
    size_t farther = 0;
    for (size_t i = 0; i < t.model.n_images; i++) {
        const float *v = t.model.images + i * IMAGE;
        double dot = 0, own = 0;
        for (size_t j = 0; j < IMAGE; j++) {
            dot += (double)v[j] * want[j];
            own += (double)v[j] * (double)v[j];
        }
        double cosine = dot / sqrt(length * own);
        const char *name = NULL;
        for (size_t k = 0; k < NEAREST && !name; k++)
            if (!strcmp(text_of(json_array_get(near, k), "name"), t.model.names[i])) {
                name = t.model.names[i];
                assert_true(fabs(told[k] - cosine) < 1e-6);
            }
        if (!name)
            assert_true(cosine <= last + 1e-6);
        farther += !name;
    }
    assert_int_equal(farther, t.model.n_images - NEAREST);
}

static void the_list_names_every_look_with_links_that_work(void **state)
{
    char path[2048];
    json_t *o = get_json("/d/lit/appearances"), *list = json_object_get(o, "appearances");
    assert_string_equal(text_of(o, "default"), BAKE_DEFAULT);
    assert_int_equal(json_array_size(list), PHOTOS + 1);
    for (size_t i = 0; i <= PHOTOS; i++) {
        const size_t row[] = {i};
        const double one[] = {1};
        double want[IMAGE];
        const json_t *item = json_array_get(list, i);
        assert_string_equal(text_of(item, "name"), t.model.names[i]);
        json_t *found = get_json(href(item, "item", path));
        assert_string_equal(text_of(found, "appearance"), t.model.names[i]);
        blend(row, one, 1, want);
        assert_embedding(found, want);
        assert_nearest(found, want);
        const json_t *near = json_array_get(json_object_get(found, "nearest"), 0);
        assert_string_equal(text_of(near, "name"), t.model.names[i]);
        assert_true(fabs(json_number_value(json_object_get(near, "cosine")) - 1) < 1e-6);
        json_decref(found);
        struct response r = get(href(item, "tileset", path), 200);
        response_free(&r);
    }
    json_decref(o);
    o = get_json("/d/plain/appearances");
    assert_int_equal(json_array_size(json_object_get(o, "appearances")), 0);
    json_decref(o);
    struct response r = get("/collections/lit", 200);
    assert_true(says(&r, "d/lit/appearances"));
    response_free(&r);
}

static void blends_and_posted_mixes_are_the_same_embedding(void **state)
{
    char target[2048];
    double want[IMAGE];
    float first[IMAGE], again[IMAGE];
    const size_t rows[] = {1, 2};
    const double weights[] = {0.25, 0.75};
    blend(rows, weights, 2, want);
    json_t *o = get_json("/d/lit/appearance?appearance=p1.jpg:1,p2.jpg%3A3");
    assert_embedding(o, want);
    json_decref(o);
    struct response r =
        ask(METHOD_POST, "/d/lit/appearances:mix", "{\"weights\":{\"p1.jpg\":1,\"p2.jpg\":3}}");
    assert_int_equal(r.status, 200);
    o = json_of(&r);
    assert_embedding(o, want);
    json_t *linked = get_json(href(o, "self", target));
    assert_embedding(linked, want);
    json_decref(linked);
    json_decref(o);

    /* an embedding comes back to the last bit */
    struct buf body = {0};
    buf_printf(&body, "{\"embedding\":[");
    for (size_t i = 0; i < IMAGE; i++) {
        first[i] = (float)(i % 2 ? -1.0 : 1.0) / (float)(3 * i + 1);
        buf_printf(&body, "%s%.9g", i ? "," : "", (double)first[i]);
    }
    buf_printf(&body, "]}");
    r = ask(METHOD_POST, "/d/lit/appearances:mix", (const char *)body.data);
    assert_int_equal(r.status, 200);
    o = json_of(&r);
    assert_int_equal(text_of(o, "appearance")[0], '=');
    linked = get_json(href(o, "self", target));
    embedding_of(linked, again);
    assert_memory_equal(first, again, sizeof first);
    json_decref(linked);
    json_decref(o);
    buf_free(&body);
}

/* An embedding has one spelling: another one is refused, and told the right one. */
static void embeddings_have_one_spelling(void **state)
{
    struct buf body = {0}, target = {0};
    char text[TARGET_APPEARANCE_MAX];
    buf_printf(&body, "{\"embedding\":[-0.0");
    for (size_t i = 1; i < IMAGE; i++)
        buf_printf(&body, ",%zu", i % 2);
    buf_printf(&body, "]}");
    struct response r = ask(METHOD_POST, "/d/lit/appearances:mix", (const char *)body.data);
    assert_int_equal(r.status, 200);
    json_t *o = json_of(&r);
    snprintf(text, sizeof text, "%s", text_of(o, "appearance"));
    json_decref(o);
    assert_true(strlen(text) % 4 !=
                1); /* "=" and a whole number of threes would have no spare bits */
    for (int kind = 0; kind < 3; kind++) {
        char other[TARGET_APPEARANCE_MAX];
        snprintf(other, sizeof other, "%s", text);
        if (kind == 1)
            other[strlen(other) - 1]++; /* spare bits */
        else if (kind == 2)
            other[5] = 'g'; /* -0.0: the sign is the highest bit of the fourth byte */
        target.size = 0;
        buf_printf(&target, "/d/lit/appearance?appearance=%s", other);
        r = get((const char *)target.data, kind ? 400 : 200);
        if (kind)
            assert_true(says(&r, text));
        response_free(&r);
    }
    buf_free(&body);
    buf_free(&target);
}

/* The .ply of the tile, and what it should be. */
static void tile_in(const char *query, char etag[BODY_ETAG_SIZE], struct gauss *out)
{
    struct err e = {0};
    char target[2048];
    struct ply_info info;
    const struct key k = served_key(17);
    const struct dataset *d = catalog_find(t.s.catalog, "lit", "");
    snprintf(target, sizeof target, "/d/lit/r/%s/t/%u/%u/%u.ply%s", d->meta.revision, k.z, k.x, k.y,
             query);
    struct response r = get(target, 200);
    memcpy(etag, r.etag, BODY_ETAG_SIZE);
    kit_ok(ply_decode(r.data, r.size, NULL, out, &info, &e), e);
    response_free(&r);
}

static void tiles_are_baked_in_the_look_that_is_asked_for(void **state)
{
    struct err e = {0};
    char tag[4][BODY_ETAG_SIZE];
    struct gauss g[4], want = {0};
    struct store *s;
    float image[APPEARANCE_IMAGE_MAX];
    static const char *const query[4] = {"", "?appearance=default", "?appearance=p2.jpg",
                                         "?sh=1&appearance=p2.jpg%3A7.0"};
    for (size_t i = 0; i < 4; i++)
        tile_in(query[i], tag[i], &g[i]);
    assert_string_equal(tag[0], tag[1]);
    assert_string_not_equal(tag[0], tag[2]);
    assert_string_equal(tag[2], tag[3]); /* another text of the same embedding */
    kit_ok(store_open(t.lit, &s, &e), e);
    kit_ok(bake_find(s, "p2.jpg", image, &e), e);
    kit_ok(bake_read(s, served_key(17), image, &want, &e), e);
    assert_int_equal(g[2].n, want.n);
    assert_memory_equal(g[2].sh, want.sh, 12 * want.n * sizeof(float));
    assert_memory_equal(g[2].opacity_logit, want.opacity_logit, want.n * sizeof(float));
    assert_memory_not_equal(g[0].sh, want.sh, 12 * want.n * sizeof(float));
    store_close(&s);
    gauss_free(&want);
    for (size_t i = 0; i < 4; i++)
        gauss_free(&g[i]);
}

/* base64url without padding, as the standard says it. */
static void floats_of(const json_t *o, const char *key, float *out, size_t n)
{
    static const char digits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_";
    const char *text = text_of(o, key);
    uint8_t *bytes = (uint8_t *)out;
    size_t got = 0;
    assert_int_equal(strlen(text), (16 * n + 2) / 3);
    uint32_t bits = 0;
    for (size_t i = 0, have = 0; text[i]; i++) {
        bits = bits << 6 | (uint32_t)(strchr(digits, text[i]) - digits);
        have += 6;
        if (have >= 8 && got < 4 * n) {
            have -= 8;
            bytes[got++] = (uint8_t)(bits >> have);
        }
    }
    assert_int_equal(got, 4 * n);
}

static json_t *document_of_revision(const char *name)
{
    char target[256];
    const struct dataset *d = catalog_find(t.s.catalog, "lit", "");
    snprintf(target, sizeof target, "/d/lit/r/%s-%s/%s", d->meta.revision, d->edition, name);
    struct response r = get(target, 200);
    assert_non_null(strstr(r.cache_control, "immutable"));
    assert_int_equal(r.etag[0], '"');
    return json_of(&r);
}

/* The formula of docs/appearance.md, "In a client", from the documents and the tile alone. */
static void client_colours(const json_t *network, const float *image, const float *embed,
                           double y[APPEARANCE_OUT])
{
    enum { HIDDEN = 8, IN = LEN + IMAGE };
    float w[HIDDEN * IN + HIDDEN + 4 * HIDDEN + 4];
    const float *b1 = w + HIDDEN * IN, *w2 = b1 + HIDDEN, *b2 = w2 + 4 * HIDDEN;
    double input[IN], hidden[HIDDEN], norm[2] = {0};
    floats_of(network, "weights", w, sizeof w / sizeof *w);
    for (size_t i = 0; i < IN; i++) {
        input[i] = (double)(i < LEN ? embed[i] : image[i - LEN]);
        norm[i >= LEN] += input[i] * input[i];
    }
    for (size_t h = 0; h < HIDDEN; h++) {
        hidden[h] = (double)b1[h];
        for (size_t i = 0; i < IN; i++)
            hidden[h] += (double)w[IN * h + i] * input[i] / sqrt(norm[i >= LEN]);
    }
    for (size_t o = 0; o < APPEARANCE_OUT; o++) {
        double z = (double)b2[o];
        for (size_t h = 0; h < HIDDEN; h++)
            z += (double)w2[HIDDEN * o + h] * fmax(0, hidden[h]);
        y[o] = 1 / (1 + exp(-z));
    }
}

static void trained_tile(const char *ext, struct response *out)
{
    char target[256];
    const struct key k = served_key(17);
    const struct dataset *d = catalog_find(t.s.catalog, "lit", "");
    snprintf(target, sizeof target, "/d/lit/r/%s/t/%u/%u/%u.%s", d->meta.revision, k.z, k.x, k.y,
             ext);
    *out = get(target, 200);
}

static void a_client_gets_the_colours_that_the_server_bakes(void **state)
{
    struct err e = {0};
    struct response drc, baked_drc;
    struct quant q;
    struct gauss trained, want;
    struct store *s;
    float standard[IMAGE], images[PHOTOS * IMAGE];
    double worst[2] = {0};
    json_t *network = document_of_revision("appearance.json"),
           *photographs = document_of_revision("appearances.json");
    assert_string_equal(text_of(network, "format"), "citysplat-appearance-1");
    floats_of(network, "default", standard, IMAGE);
    floats_of(photographs, "embeddings", images, PHOTOS * IMAGE);
    assert_memory_equal(images, t.model.images, sizeof images);
    assert_memory_equal(standard, t.model.images + PHOTOS * IMAGE, sizeof standard);
    trained_tile("drc?appearance=none&preset=near-lossless", &drc);
    trained_tile("drc?preset=near-lossless", &baked_drc);
    assert_string_not_equal(drc.etag, baked_drc.etag);
    kit_ok(draco_decode(drc.data, drc.size, NULL, &q, &e), e);
    kit_ok(quant_to_gauss(&q, &trained, &e), e);
    kit_ok(store_open(t.lit, &s, &e), e);
    for (size_t photo = 0; photo <= PHOTOS; photo++) {
        const float *image = photo < PHOTOS ? images + photo * IMAGE : standard;
        kit_ok(bake_read(s, served_key(17), image, &want, &e), e);
        assert_int_equal(trained.n, want.n);
        for (size_t i = 0; i < want.n; i++) {
            double y[APPEARANCE_OUT];
            client_colours(network, image, trained.embed + i * LEN, y);
            for (size_t c = 0; c < 3; c++) {
                double got = (double)trained.sh[12 * i + c] * 0.28209479177387814 + 2 * y[c] - 1,
                       is = (double)want.sh[12 * i + c] * 0.28209479177387814;
                worst[0] = fmax(worst[0], fabs(got - is));
            }
            double got = fmin(1, 1 / (1 + exp(-(double)trained.opacity_logit[i])) + y[3]),
                   is = 1 / (1 + exp(-(double)want.opacity_logit[i]));
            worst[1] = fmax(worst[1], fabs(got - is));
        }
        gauss_free(&want);
    }
    print_message("colours within %.5f, opacities within %.5f of what is baked\n", worst[0],
                  worst[1]);
    assert_true(worst[0] < 2.0 / 255 && worst[1] < 2.0 / 255);
    store_close(&s);
    gauss_free(&trained);
    quant_free(&q);
    response_free(&drc);
    response_free(&baked_drc);
    json_decref(network);
    json_decref(photographs);
}

static void none_is_what_was_trained(void **state)
{
    struct err e = {0};
    char tag[2][BODY_ETAG_SIZE];
    struct gauss got, want;
    struct store *s;
    tile_in("?appearance=none", tag[0], &got);
    kit_ok(store_open(t.lit, &s, &e), e);
    kit_ok(store_read_gauss(s, served_key(17), &want, &e), e);
    assert_memory_equal(got.sh, want.sh, 12 * want.n * sizeof(float));
    assert_memory_equal(got.opacity_logit, want.opacity_logit, want.n * sizeof(float));
    store_close(&s);
    gauss_free(&got);
    tile_in("", tag[1], &got);
    assert_memory_not_equal(got.sh, want.sh, 12 * want.n * sizeof(float));
    assert_string_not_equal(tag[0], tag[1]);
    gauss_free(&got);
    gauss_free(&want);
    struct response r = get("/d/lit/tileset.json?appearance=none", 200);
    assert_true(says(&r, ".glb?appearance=none"));
    response_free(&r);
    r = get("/d/plain/tileset.json?appearance=none", 200); /* has no other */
    response_free(&r);
}

static void photographs_have_times_poses_and_thumbnails(void **state)
{
    char target[256];
    const struct dataset *d = catalog_find(t.s.catalog, "lit", "");
    json_t *o = document_of_revision("appearances.json"), *list = json_object_get(o, "photographs"),
           *odd = json_array_get(list, 3);
    assert_int_equal(json_array_size(list), PHOTOS);
    assert_string_equal(text_of(odd, "name"), ODD_NAME);
    assert_string_equal(text_of(odd, "time"), "2024-06-01T10:00:03");
    assert_true(fabs(json_number_value(json_object_get(odd, "lat")) + 47.25) < 1e-9);
    assert_true(fabs(json_number_value(json_object_get(odd, "heading")) - 359.5) < 1e-9);
    assert_null(json_object_get(json_array_get(list, 0), "thumbnail"));
    snprintf(target, sizeof target, "/d/lit/r/%s/%s", d->meta.revision, text_of(odd, "thumbnail"));
    json_decref(o);
    struct response r = get(target, 200);
    assert_string_equal(r.type, "image/jpeg");
    assert_int_equal(r.size, sizeof JPEG);
    assert_memory_equal(r.data, JPEG, sizeof JPEG);
    assert_non_null(strstr(r.cache_control, "immutable"));
    response_free(&r);
    snprintf(target, sizeof target, "/d/lit/r/%s/appearances/0.jpg", d->meta.revision);
    r = get(target, 404);
    assert_true(says(&r, "\"this photograph has no thumbnail\""));
    response_free(&r);
    snprintf(target, sizeof target, "/d/lit/r/%s/appearances/6.jpg", d->meta.revision);
    r = get(target, 404); /* the default appearance is no photograph */
    response_free(&r);
    d = catalog_find(t.s.catalog, "plain", "");
    static const char *const none[] = {"appearance.json", "appearances.json", "appearances/0.jpg"};
    for (size_t i = 0; i < sizeof none / sizeof *none; i++) {
        snprintf(target, sizeof target, "/d/plain/r/%s/%s", d->meta.revision, none[i]);
        r = get(target, 404);
        response_free(&r);
    }
}

static void tilesets_and_prefetch_lists_carry_the_look(void **state)
{
    char want[256], target[512];
    const struct dataset *d = catalog_find(t.s.catalog, "lit", "");
    const struct key k = served_key(17);
    static const char query[] = "?preset=preview&sh=0&appearance=roof%2050%25%26=%2B%C3%A9.jpg";
    for (int moving = 0; moving < 2; moving++) {
        snprintf(target, sizeof target, "/d/lit/%s%s%stileset.json%s", moving ? "" : "r/",
                 moving ? "" : d->meta.revision, moving ? "" : "/", query);
        struct response r = get(target, 200);
        snprintf(want, sizeof want, "\"%s%s%s%s%st/%u/%u/%u.glb%s\"", moving ? "r/" : "",
                 moving ? d->meta.revision : "", moving ? "-" : "", moving ? d->edition : "",
                 moving ? "/" : "", k.z, k.x, k.y, query);
        if (!says(&r, want))
            fail_msg("%s lacks %s: %.*s", target, want, (int)r.size, (const char *)r.data);
        response_free(&r);
    }
    snprintf(target, sizeof target, "/d/lit/seed.ndjson?f=spz&appearance=p1.jpg");
    struct response r = get(target, 200);
    json_t *line = json_loadb((const char *)r.data, r.size, JSON_DISABLE_EOF_CHECK, NULL);
    assert_non_null(line);
    snprintf(target, sizeof target, "/d/lit/%s", text_of(line, "url"));
    struct response tile = get(target, 200);
    assert_string_equal(tile.etag, text_of(line, "etag"));
    assert_non_null(strstr(tile.cache_control, "immutable"));
    assert_non_null(strstr(target, ".spz?appearance=p1.jpg"));
    json_decref(line);
    response_free(&tile);
    response_free(&r);
    /* a row repeats the query: work_room counts that (ask) */
    r = get(
        "/d/lit/seed.ndjson?appearance=p1.jpg:1.00000000000000000000000000000000000000000000000001,"
        "p2.jpg:1.00000000000000000000000000000000000000000000000000000000000000000000000000001,"
        "p4.jpg:1.00000000000000000000000000000000000000000000000000000000000000000000000000001",
        200);
    response_free(&r);
    r = get("/d/lit/static/13.4,52.5,120@0,-90/64x64.jpg?appearance=p1.jpg", 307);
    assert_non_null(strstr(r.location, "64x64.jpg?appearance=p1.jpg"));
    response_free(&r);
}

static enum err_code ask_one(void *user, size_t i, struct err *e)
{
    _Atomic size_t *n_found = user;
    char target[128];
    snprintf(target, sizeof target, "/d/lit/appearance?appearance=p%zu.jpg:%zu,p4.jpg:1", i % 3,
             i + 1);
    const struct request r = {.target = target, .target_size = strlen(target)};
    struct response out;
    (void)e;
    dispatch_answer(&t.s, &r, &out);
    atomic_fetch_add(n_found, out.status == 200);
    response_free(&out);
    return ERR_OK;
}

/* On threads of HTTP; the ThreadSanitizer looks at this. */
static void many_ask_at_once(void **state)
{
    enum { N = 200 };
    struct err e = {0};
    _Atomic size_t n_found = 0;
    kit_ok(pool_for(N, 4, ask_one, &n_found, &e), e);
    assert_int_equal(n_found, N);
}

static void what_is_no_look_is_a_clear_answer(void **state)
{
    char target[2048];
    static const struct {
        enum method method;
        const char *target, *body;
        int status;
        const char *says;
    } rows[] = {
        {METHOD_GET, "/d/lit/appearance?appearance=p9.jpg", NULL, 404, "p9.jpg"},
        {METHOD_GET, "/d/lit/appearance?appearance=p1.jpg:x", NULL, 400, "number"},
        {METHOD_GET, "/d/lit/appearance?appearance=p1.jpg:1,p2.jpg:-1", NULL, 400,
         "add up to more than 0"},
        {METHOD_GET, "/d/lit/appearance?appearance=p1.jpg:-1", NULL, 400, "add up to more than 0"},
        {METHOD_POST, "/d/lit/appearances:mix", "{\"weights\":{\"p1.jpg\":-2,\"p2.jpg\":1}}", 400,
         "add up to more than 0"},
        {METHOD_GET, "/d/lit/appearance?appearance=p1.jpg:1e308,p2.jpg:1e308", NULL, 400,
         "overflow"},
        {METHOD_GET, "/d/lit/appearance?appearance=p1.jpg:1,p2.jpg:-0.9999999", NULL, 400,
         "cancel"},
        {METHOD_POST, "/d/lit/appearances:mix", "{\"weights\":{\"p1.jpg\":1e308,\"p2.jpg\":1e308}}",
         400, "overflow"},
        {METHOD_GET, "/d/lit/appearance?appearance==AAAA", NULL, 400, "base64url"},
        {METHOD_GET, "/d/lit/appearance?appearance=", NULL, 400, "appearance"},
        {METHOD_GET, "/d/lit/appearance?appearance=%4", NULL, 400, "percent-encoded"},
        {METHOD_GET, "/d/lit/appearance?appearance=%00", NULL, 400, "percent-encoded"},
        {METHOD_GET, "/d/lit/appearance?appearance=%FF%FE", NULL, 400, "UTF-8"},
        {METHOD_GET, "/d/lit/appearance?appearance=%C3", NULL, 400, "UTF-8"},
        {METHOD_GET, "/d/lit/appearance?appearance=p%C3%A9", NULL, 404, "p\u00e9"},
        {METHOD_GET, "/d/lit/appearance?appearance=a&appearance=b", NULL, 400, "once"},
        {METHOD_GET, "/d/lit/appearance?appearance=none", NULL, 400, "of tiles"},
        {METHOD_GET, "/d/lit/tileset.json?appearance=p9.jpg", NULL, 404, "p9.jpg"},
        {METHOD_GET, "/d/lit/seed.ndjson?appearance=p9.jpg", NULL, 404, "p9.jpg"},
        {METHOD_GET, "/d/plain/tileset.json?appearance=p1.jpg", NULL, 404, "without appearance"},
        {METHOD_GET, "/d/plain/appearance", NULL, 404, "without appearance"},
        {METHOD_POST, "/d/lit/appearances:mix", NULL, 400, "weights"},
        {METHOD_POST, "/d/lit/appearances:mix", "{", 400, "body"},
        {METHOD_POST, "/d/lit/appearances:mix", "{}", 422, "weights"},
        {METHOD_POST, "/d/lit/appearances:mix", "{\"weights\":{}}", 422, "1 to 16"},
        {METHOD_POST, "/d/lit/appearances:mix", "{\"weights\":{\"p9.jpg\":1}}", 404, "p9.jpg"},
        {METHOD_POST, "/d/lit/appearances:mix", "{\"weights\":{\"p1.jpg\":\"1\"}}", 422, "number"},
        {METHOD_POST, "/d/lit/appearances:mix", "{\"embedding\":[1,2]}", 422, "13 numbers"},
        {METHOD_POST, "/d/lit/appearances:mix",
         "{\"embedding\":[1,2,3,4,5,6,7,8,9,10,11,12,\"x\"]}", 422, "number 12"},
        {METHOD_POST, "/d/plain/appearances:mix", "{\"embedding\":[1]}", 404, "without appearance"},
        {METHOD_GET, "/d/lit/appearances:mix", NULL, 405, "method"},
    };
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        struct response r = ask(rows[i].method, rows[i].target, rows[i].body);
        if (r.status != rows[i].status || !says(&r, rows[i].says))
            fail_msg("%s %s: %d (%d wanted) %.*s", rows[i].target, rows[i].body ? rows[i].body : "",
                     r.status, rows[i].status, (int)r.size, (const char *)r.data);
        response_free(&r);
    }
    int n = snprintf(target, sizeof target, "/d/lit/appearance?appearance=");
    memset(target + n, 'a', TARGET_APPEARANCE_MAX);
    target[n + TARGET_APPEARANCE_MAX] = '\0';
    struct response r = get(target, 400);
    response_free(&r);
    response_problem(&r, 400, "cut within a letter: \xc3");
    json_decref(json_of(&r));
    response_free(&r);
    /* conditions are of GET and HEAD: who posts is answered */
    static const char body[] = "{\"weights\":{\"p1.jpg\":1}}", mix[] = "/d/lit/appearances:mix";
    const struct request q = {.method = METHOD_POST,
                              .target = mix,
                              .target_size = sizeof mix - 1,
                              .body = body,
                              .body_size = sizeof body - 1,
                              .if_none_match = "*"};
    dispatch_answer(&t.s, &q, &r);
    assert_int_equal(r.status, 200);
    response_free(&r);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_list_names_every_look_with_links_that_work),
        cmocka_unit_test(blends_and_posted_mixes_are_the_same_embedding),
        cmocka_unit_test(embeddings_have_one_spelling),
        cmocka_unit_test(tiles_are_baked_in_the_look_that_is_asked_for),
        cmocka_unit_test(none_is_what_was_trained),
        cmocka_unit_test(a_client_gets_the_colours_that_the_server_bakes),
        cmocka_unit_test(photographs_have_times_poses_and_thumbnails),
        cmocka_unit_test(tilesets_and_prefetch_lists_carry_the_look),
        cmocka_unit_test(what_is_no_look_is_a_clear_answer),
        cmocka_unit_test(many_ask_at_once),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
