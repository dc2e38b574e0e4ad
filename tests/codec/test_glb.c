/* .glb: the rules that real clients need, the payload, and hostile files.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/limits.h"
#include "codec/splat/axes.h"
#include "codec/splat/glb.h"
#include "codec/splat/quant.h"
#include "codec/splat/spz.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXT "KHR_gaussian_splatting"

static uint32_t u32_at(const struct buf *b, size_t at)
{
    uint32_t v;
    assert_true(at + 4 <= b->size);
    memcpy(&v, b->data + at, 4);
    return v;
}

/* Chunks checked; the JSON parsed. */
static json_t *json_of(const struct buf *b, size_t *bin_at, size_t *bin_size)
{
    json_error_t je;
    assert_int_equal(u32_at(b, 0), 0x46546c67);
    assert_int_equal(u32_at(b, 4), 2);
    assert_int_equal(u32_at(b, 8), b->size);
    uint32_t n_json = u32_at(b, 12);
    assert_int_equal(u32_at(b, 16), 0x4e4f534a);
    assert_int_equal(n_json % 4, 0);
    uint32_t n_bin = u32_at(b, 20 + n_json);
    assert_int_equal(u32_at(b, 24 + n_json), 0x004e4942);
    assert_int_equal(n_bin % 4, 0);
    assert_int_equal(28 + n_json + n_bin, b->size);
    *bin_at = 28 + n_json;
    *bin_size = n_bin;
    json_t *root = json_loadb((const char *)b->data + 20, n_json, JSON_REJECT_DUPLICATES, &je);
    if (!root)
        fail_msg("JSON: %s", je.text);
    return root;
}

static json_t *primitive_of(json_t *root)
{
    assert_int_equal(json_array_size(json_object_get(root, "nodes")), 1);
    assert_int_equal(json_array_size(json_object_get(root, "meshes")), 1);
    json_t *node = json_array_get(json_object_get(root, "nodes"), 0);
    assert_int_equal(json_object_size(node), 1); /* mesh, and no transform: Cesium stops at one */
    json_t *mesh = json_array_get(json_object_get(root, "meshes"), 0);
    json_t *prims = json_object_get(mesh, "primitives");
    assert_int_equal(json_array_size(prims), 1);
    json_t *prim = json_array_get(prims, 0);
    assert_int_equal(json_integer_value(json_object_get(prim, "mode")), 0);
    return prim;
}

/* The accessor of an attribute, of this type. */
static json_t *accessor_of(json_t *root, json_t *prim, const char *name, int component,
                           const char *type)
{
    json_t *index = json_object_get(json_object_get(prim, "attributes"), name);
    if (!json_is_integer(index))
        fail_msg("no attribute %s", name);
    json_t *a =
        json_array_get(json_object_get(root, "accessors"), (size_t)json_integer_value(index));
    assert_int_equal(json_integer_value(json_object_get(a, "componentType")), component);
    assert_string_equal(json_string_value(json_object_get(a, "type")), type);
    return a;
}

/* Whole bands of harmonics from `first` on, and no other. */
static void expect_bands(json_t *root, json_t *prim, uint32_t first, uint32_t degree)
{
    size_t n = 0, have = 0;
    const char *name;
    json_t *index;
    for (uint32_t l = first; l <= degree; l++)
        for (uint32_t m = 0; m <= 2 * l; m++, n++) {
            char want[64];
            snprintf(want, sizeof want, EXT ":SH_DEGREE_%u_COEF_%u", l, m);
            accessor_of(root, prim, want, 5126, "VEC3");
        }
    json_object_foreach(json_object_get(prim, "attributes"), name, index)
    {
        have += strstr(name, "SH_DEGREE") != NULL;
    }
    assert_int_equal(have, n);
}

/* What the container itself must be: one scene of one node, chunks padded as glTF says, one buffer
 * that is the binary chunk, the extension's constants. */
static void expect_container(const struct buf *b, json_t *root, json_t *prim, size_t bin_at,
                             size_t bin_size)
{
    json_t *scenes = json_object_get(root, "scenes"), *buffers = json_object_get(root, "buffers");
    assert_int_equal(json_array_size(scenes), 1);
    assert_int_equal(json_integer_value(json_object_get(root, "scene")), 0);
    json_t *nodes = json_object_get(json_array_get(scenes, 0), "nodes");
    assert_int_equal(json_array_size(nodes), 1);
    assert_int_equal(json_integer_value(json_array_get(nodes, 0)), 0);
    assert_string_equal(
        json_string_value(json_object_get(json_object_get(root, "asset"), "version")), "2.0");
    assert_int_equal(json_array_size(buffers), 1);
    size_t used =
        (size_t)json_integer_value(json_object_get(json_array_get(buffers, 0), "byteLength"));
    assert_true(used <= bin_size && bin_size - used < 4);
    for (size_t i = used; i < bin_size; i++)
        assert_int_equal(b->data[bin_at + i], 0);
    size_t end = 20 + u32_at(b, 12);
    while (end > 20 && b->data[end - 1] == ' ')
        end--;
    assert_int_equal(b->data[end - 1], '}');
    json_t *splat = json_object_get(json_object_get(prim, "extensions"), EXT);
    static const char *const constants[][2] = {{"kernel", "ellipse"},
                                               {"colorSpace", "srgb_rec709_display"},
                                               {"sortingMethod", "cameraDistance"},
                                               {"projection", "perspective"}};
    for (size_t i = 0; i < 4; i++)
        assert_string_equal(json_string_value(json_object_get(splat, constants[i][0])),
                            constants[i][1]);
}

static void test_spz_form_follows_the_clients(void **state)
{
    for (uint32_t degree = 0; degree <= 3; degree++) {
        struct gauss g, back;
        struct quant q;
        struct buf b = {0}, spz = {0};
        struct err e = {0};
        size_t bin_at, bin_size;
        kit_gauss(degree, 321, 500, degree, 0, &g);
        kit_ok(quant_from_gauss(&g, degree, NULL, &q, &e), e);
        kit_ok(glb_encode_spz(&q, "\xc2\xa9 Survey \"2026\"", &b, &e), e);
        json_t *root = json_of(&b, &bin_at, &bin_size), *prim = primitive_of(root);
        assert_string_equal(
            json_string_value(json_object_get(json_object_get(root, "asset"), "copyright")),
            "\xc2\xa9 Survey \"2026\"");
        for (const char *const *list =
                 (const char *const[]){"extensionsUsed", "extensionsRequired", NULL};
             *list; list++) {
            json_t *l = json_object_get(root, *list);
            assert_int_equal(json_array_size(l), 2);
            assert_string_equal(json_string_value(json_array_get(l, 0)), EXT);
            assert_string_equal(json_string_value(json_array_get(l, 1)), EXT "_compression_spz_2");
        }
        expect_container(&b, root, prim, bin_at, bin_size);
        json_t *spz_ext = json_object_get(
            json_object_get(json_object_get(json_object_get(prim, "extensions"), EXT),
                            "extensions"),
            EXT "_compression_spz_2");
        assert_int_equal(json_integer_value(json_object_get(spz_ext, "bufferView")), 0);
        accessor_of(root, prim, "POSITION", 5126, "VEC3");
        assert_true(json_is_true(
            json_object_get(accessor_of(root, prim, "COLOR_0", 5121, "VEC4"), "normalized")));
        accessor_of(root, prim, EXT ":SCALE", 5126, "VEC3");
        accessor_of(root, prim, EXT ":ROTATION", 5126, "VEC4");
        expect_bands(root, prim, 1, degree);

        json_t *attributes = json_object_get(prim, "attributes"), *index;
        assert_int_equal(json_object_size(attributes), 4 + gauss_sh_count(degree) - 1);
        assert_null(
            json_object_get(attributes, EXT ":SH_DEGREE_0_COEF_0")); /* Cesium would drop all SH */
        assert_non_null(json_object_get(attributes, "COLOR_0"));
        assert_non_null(json_object_get(attributes, EXT ":SCALE"));
        assert_non_null(json_object_get(attributes, EXT ":ROTATION"));
        const char *name;
        json_object_foreach(attributes, name, index)
        {
            json_t *a = json_array_get(json_object_get(root, "accessors"),
                                       (size_t)json_integer_value(index));
            assert_int_equal(json_integer_value(json_object_get(a, "count")), 321);
            assert_null(json_object_get(a, "bufferView"));
        }
        kit_ok(quant_to_gauss(&q, &back, &e), e);
        json_t *pos = json_array_get(json_object_get(root, "accessors"), 0);
        for (size_t c = 0; c < 3; c++) {
            float lo = INFINITY, hi = -INFINITY;
            for (size_t i = 0; i < back.n; i++) {
                lo = fminf(lo, back.mean_m[3 * i + c]);
                hi = fmaxf(hi, back.mean_m[3 * i + c]);
            }
            assert_true(json_real_value(json_array_get(json_object_get(pos, "min"), c)) ==
                        (double)lo);
            assert_true(json_real_value(json_array_get(json_object_get(pos, "max"), c)) ==
                        (double)hi);
        }
        const void *inside;
        size_t n_inside;
        kit_ok(spz_encode(&q, 3, &spz, &e), e);
        kit_ok(glb_find_spz(b.data, b.size, &inside, &n_inside, &e), e);
        assert_int_equal(n_inside, spz.size);
        assert_memory_equal(inside, spz.data, spz.size);
        assert_ptr_equal(inside, b.data + bin_at);
        json_t *views = json_object_get(root, "bufferViews"), *view = json_array_get(views, 0);
        assert_int_equal(json_array_size(views), 1);
        assert_int_equal(json_integer_value(json_object_get(view, "byteOffset")), 0);
        assert_int_equal(json_integer_value(json_object_get(view, "byteLength")), spz.size);
        json_decref(root);
        gauss_free(&back);
        gauss_free(&g);
        quant_free(&q);
        buf_free(&b);
        buf_free(&spz);
    }
}

/* Float32 rounding of exp and log, there and back. */
#define LOG_TOL 2e-5
#define QUAT_TOL 1e-6
#define LINEAR_TOL 1e-5 /* float32 exp and pow against double */

/* Sigma and opacity are linear, rotations x y z w of unit length, COLOR_0 is the base colour
 * without the sRGB curve, and every row starts on four bytes. */
static void expect_linear_values(const struct buf *b, json_t *root, json_t *prim, size_t bin_at,
                                 const struct gauss *g)
{
    const struct {
        const char *name, *type;
        size_t width;
    } list[] = {{EXT ":SCALE", "VEC3", 3},
                {EXT ":OPACITY", "SCALAR", 1},
                {EXT ":ROTATION", "VEC4", 4},
                {"COLOR_0", "VEC4", 4}};
    for (size_t a = 0; a < 4; a++) {
        json_t *acc = accessor_of(root, prim, list[a].name, 5126, list[a].type);
        json_t *view =
            json_array_get(json_object_get(root, "bufferViews"),
                           (size_t)json_integer_value(json_object_get(acc, "bufferView")));
        size_t at = (size_t)json_integer_value(json_object_get(view, "byteOffset"));
        assert_int_equal(at % 4, 0);
        for (size_t i = 0; i < g->n; i++) {
            float v[4];
            double want[4] = {0}, len = 0;
            memcpy(v, b->data + bin_at + at + 4 * list[a].width * i, 4 * list[a].width);
            const float *q = g->quat_wxyz + 4 * i;
            for (int c = 0; c < 4; c++)
                len += (double)q[c] * (double)q[c];
            for (size_t c = 0; c < list[a].width; c++) {
                double srgb =
                    c < 3 ? 0.28209479177387814 *
                                    (double)g->sh[3 * gauss_sh_count(g->sh_degree) * i + c] +
                                0.5
                          : 0;
                srgb = fmin(fmax(srgb, 0), 1);
                want[c] = a == 0             ? exp((double)g->scale_log[3 * i + c])
                          : a == 1 || c == 3 ? 1 / (1 + exp(-(double)g->opacity_logit[i]))
                                             : pow((srgb + 0.055) / 1.055, 2.4);
                if (a == 3 && c < 3 && srgb <= 0.04045)
                    want[c] = srgb / 12.92;
                if (a == 2)
                    want[c] = (double)q[(c + 1) % 4] / sqrt(len);
            }
            kit_near(list[a].name, v, want, list[a].width, LINEAR_TOL, LINEAR_TOL);
        }
    }
}

static void test_plain_form(void **state)
{
    for (uint32_t degree = 0; degree <= 3; degree++) {
        struct gauss g, back;
        struct buf b = {0};
        struct err e = {0};
        size_t bin_at, bin_size;
        kit_gauss(degree, 77, 500, degree, 3, &g);
        kit_ok(glb_encode_plain(&g, NULL, &b, &e), e);
        json_t *root = json_of(&b, &bin_at, &bin_size), *prim = primitive_of(root);
        assert_null(json_object_get(json_object_get(root, "asset"), "copyright"));
        assert_null(json_object_get(root, "extensionsRequired"));
        assert_int_equal(json_object_size(json_object_get(prim, "attributes")),
                         5 + gauss_sh_count(degree));
        expect_container(&b, root, prim, bin_at, bin_size);
        json_t *used = json_object_get(root, "extensionsUsed");
        assert_int_equal(json_array_size(used), 1);
        assert_string_equal(json_string_value(json_array_get(used, 0)), EXT);
        json_t *position = accessor_of(root, prim, "POSITION", 5126, "VEC3");
        assert_int_equal(json_array_size(json_object_get(position, "min")), 3);
        assert_int_equal(json_array_size(json_object_get(position, "max")), 3);
        accessor_of(root, prim, EXT ":SCALE", 5126, "VEC3");
        accessor_of(root, prim, EXT ":ROTATION", 5126, "VEC4");
        accessor_of(root, prim, EXT ":OPACITY", 5126, "SCALAR");
        expect_bands(root, prim, 0, degree);
        expect_linear_values(&b, root, prim, bin_at, &g);
        json_decref(root);
        kit_ok(glb_decode(b.data, b.size, NULL, &back, &e), e);
        assert_int_equal(back.n, g.n);
        assert_int_equal(back.sh_degree, degree);
        assert_memory_equal(back.mean_m, g.mean_m, g.n * 12);
        assert_memory_equal(back.sh, g.sh, g.n * 12 * gauss_sh_count(degree));
        for (size_t i = 0; i < g.n; i++) {
            double want[4], norm = 0;
            for (int c = 0; c < 3; c++)
                want[c] = (double)g.scale_log[3 * i + c];
            kit_near("scale", back.scale_log + 3 * i, want, 3, LOG_TOL, 0);
            want[0] = (double)g.opacity_logit[i];
            kit_near("opacity", back.opacity_logit + i, want, 1, LOG_TOL, 0);
            for (int c = 0; c < 4; c++)
                norm += (double)g.quat_wxyz[4 * i + c] * (double)g.quat_wxyz[4 * i + c];
            for (int c = 0; c < 4; c++)
                want[c] = (double)g.quat_wxyz[4 * i + c] / sqrt(norm);
            kit_near("rotation", back.quat_wxyz + 4 * i, want, 4, QUAT_TOL, 0);
        }
        const void *inside;
        size_t n_inside;
        kit_fails(glb_find_spz(b.data, b.size, &inside, &n_inside, &e), ERR_NOENT, e, "plain");
        gauss_free(&back);
        gauss_free(&g);
        buf_free(&b);
    }
}

/* Two Gaussians whose attributes are quantised as KHR_mesh_quantization and the extension allow. */
static void test_reads_short_and_byte_accessors(void **state)
{
    static const char json[] =
        "{\"asset\":{\"version\":\"2.0\"},\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{"
        "\"mesh\":0}],"
        "\"extensionsUsed\":[\"" EXT "\"],\"buffers\":[{\"byteLength\":92}],"
        "\"meshes\":[{\"primitives\":[{\"mode\":0,\"extensions\":{\"" EXT
        "\":{\"kernel\":\"ellipse\"}},"
        "\"attributes\":{\"POSITION\":0,\"" EXT ":SCALE\":1,\"" EXT ":ROTATION\":2,"
        "\"" EXT ":OPACITY\":3,\"" EXT ":SH_DEGREE_0_COEF_0\":4}}]}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":24},{\"buffer\":0,\"byteOffset\":24,"
        "\"byteLength\":16,"
        "\"byteStride\":8},{\"buffer\":0,\"byteOffset\":40,\"byteLength\":16},"
        "{\"buffer\":0,\"byteOffset\":56,\"byteLength\":8,\"byteStride\":4},"
        "{\"buffer\":0,\"byteOffset\":64,\"byteLength\":24}],"
        "\"accessors\":[{\"bufferView\":0,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"},"
        "{\"bufferView\":1,\"componentType\":5123,\"count\":2,\"type\":\"VEC3\"},"
        "{\"bufferView\":2,\"componentType\":5122,\"normalized\":true,\"count\":2,\"type\":"
        "\"VEC4\"},"
        "{\"bufferView\":3,\"componentType\":5121,\"normalized\":true,\"count\":2,\"type\":"
        "\"SCALAR\"},"
        "{\"bufferView\":4,\"componentType\":5126,\"count\":2,\"type\":\"VEC3\"}]}";
    struct buf b = {0};
    struct gauss g;
    struct err e = {0};
    size_t n_json = (sizeof json - 1 + 3) & ~(size_t)3;
    buf_u32(&b, 0x46546c67);
    buf_u32(&b, 2);
    buf_u32(&b, (uint32_t)(28 + n_json + 92));
    buf_u32(&b, (uint32_t)n_json);
    buf_u32(&b, 0x4e4f534a);
    buf_printf(&b, "%-*s", (int)n_json, json);
    buf_u32(&b, 92);
    buf_u32(&b, 0x004e4942);
    for (int i = 0; i < 6; i++)
        buf_f32(&b, (float)i);
    for (unsigned i = 0; i < 8; i++)
        buf_u16(&b, i + 1); /* the fourth of each row is padding */
    for (int i = 0; i < 2; i++) {
        buf_u16(&b, i ? 0 : 32767); /* x y z w */
        buf_u16(&b, 0);
        buf_u16(&b, i ? 0x8001 : 0); /* -32767 */
        buf_u16(&b, 0);
    }
    buf_u32(&b, 51);
    buf_u32(&b, 255);
    for (int i = 0; i < 6; i++)
        buf_f32(&b, 0.1f * (float)i);
    buf_u32(&b, 0);
    kit_ok(glb_decode(b.data, b.size, NULL, &g, &e), e);
    assert_int_equal(g.n, 2);
    for (int i = 0; i < 6; i++) {
        assert_true(g.mean_m[i] == (float)i);
        assert_true(g.sh[i] == 0.1f * (float)i);
        assert_true(fabsf(g.scale_log[i] - logf((float)(i + 1 + i / 3))) < 1e-6f);
    }
    assert_true(fabsf(g.opacity_logit[0] + 1.3862944f) < 1e-5f);
    assert_true(isfinite(g.opacity_logit[1]) && g.opacity_logit[1] > 10);
    assert_true(g.quat_wxyz[1] == 1 && g.quat_wxyz[0] == 0);
    assert_true(g.quat_wxyz[7] == -1 && g.quat_wxyz[4] == 0);
    gauss_free(&g);
    buf_free(&b);
}

static enum err_code decode_free(const void *user, const void *bytes, size_t n,
                                 const struct codec_limits *lim, struct err *e)
{
    struct gauss g;
    (void)user;
    enum err_code rc = glb_decode(bytes, n, lim, &g, e);
    if (rc)
        assert_null(g.block);
    gauss_free(&g);
    return rc;
}

static const struct torture torture = {.name = "glb",
                                       .decode = decode_free,
                                       .errors = TORTURE(ERR_LIMIT) | TORTURE(ERR_DATA),
                                       .digits = true};

static void test_truncation_and_flips(void **state)
{
    for (int plain = 0; plain < 2; plain++) {
        struct gauss g;
        struct quant q;
        struct buf b = {0};
        struct err e = {0};
        kit_gauss(3, 12, 100, 1, 0, &g);
        kit_ok(quant_from_gauss(&g, 1, NULL, &q, &e), e);
        kit_ok(plain ? glb_encode_plain(&g, "c", &b, &e) : glb_encode_spz(&q, "c", &b, &e), e);
        torture_cuts(&torture, &b, 1);
        torture_flips(&torture, &b, 0, 5, 4000);
        struct codec_limits lim = {.max_gaussians = 11};
        kit_fails(torture_decode(&torture, b.data, b.size, &lim, &e), ERR_LIMIT, e, "limit");
        buf_free(&b);
        quant_free(&q);
        gauss_free(&g);
    }
}

static void test_refuses_what_cannot_be_written(void **state)
{
    struct gauss g;
    struct quant q = {0};
    struct buf b = {0};
    struct err e = {0};
    kit_fails(glb_encode_spz(&q, NULL, &b, &e), ERR_DATA, e, "no Gaussians");
    kit_gauss(3, 3, 100, 0, 0, &g);
    kit_fails(glb_encode_plain(&g, "\xff\xfe", &b, &e), ERR_ARG, e, "UTF-8");
    g.mean_m[4] = NAN;
    kit_fails(glb_encode_plain(&g, NULL, &b, &e), ERR_DATA, e, "row 1");
    assert_int_equal(b.size, 0);
    gauss_free(&g);
}

/* The file with nodes and scenes by `text`, and with `extra` in the extension of its primitive. */
static void with_nodes(const struct buf *b, const char *text, const char *extra, struct buf *out)
{
    size_t at, n;
    json_error_t je;
    struct err e = {0};
    json_t *root = json_of(b, &at, &n), *nodes = json_loads(text, 0, &je),
           *more = json_loads(extra, 0, &je);
    json_t *prim = primitive_of(root);
    assert_non_null(nodes);
    assert_non_null(more);
    json_object_update(json_object_get(json_object_get(prim, "extensions"), EXT), more);
    json_object_del(root, "scene");
    json_object_del(root, "scenes");
    json_object_update(root, nodes);
    char *json = json_dumps(root, JSON_COMPACT);
    const size_t n_json = (strlen(json) + 3) & ~(size_t)3;
    out->size = 0;
    buf_u32(out, 0x46546c67);
    buf_u32(out, 2);
    buf_u32(out, (uint32_t)(28 + n_json + n));
    buf_u32(out, (uint32_t)n_json);
    buf_u32(out, 0x4e4f534a);
    buf_printf(out, "%-*s", (int)n_json, json);
    buf_u32(out, (uint32_t)n);
    buf_u32(out, 0x004e4942);
    buf_add(out, b->data + at, n);
    kit_ok(buf_check(out, &e), e);
    free(json);
    json_decref(more);
    json_decref(nodes);
    json_decref(root);
}

static const char one[] = "\"scenes\":[{\"nodes\":[0]}]}";
/* a quarter turn about y: x y z -> z y -x; times 2; and 10 along x */
static const struct {
    const char *nodes;
    double scale;
    bool turned;
    double shift[3];
    size_t copies;
} placed[] = {
    {"{\"nodes\":[{\"mesh\":0,\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]}],", 1, false, {0}, 1},
    {"{\"nodes\":[{\"mesh\":0,\"translation\":[10,0,0],\"scale\":[2,2,2],"
     "\"rotation\":[0,0.70710678118654752,0,0.70710678118654752]}],",
     2,
     true,
     {10, 0, 0},
     1},
    {"{\"nodes\":[{\"mesh\":0,\"matrix\":[0,0,-2,0,0,2,0,0,2,0,0,0,10,0,0,1]}],",
     2,
     true,
     {10, 0, 0},
     1},
    {"{\"nodes\":[{\"children\":[1],\"scale\":[2,2,2]},{\"children\":[2],"
     "\"translation\":[5,0,0]},{\"mesh\":0,\"rotation\":[0,0.70710678118654752,0,"
     "0.70710678118654752]}],",
     2,
     true,
     {10, 0, 0},
     1},
    {"{\"nodes\":[{\"children\":[1,1]},{\"mesh\":0}],", 1, false, {0}, 2},
};
static const struct {
    const char *nodes, *extra, *says;
} misplaced[] = {
    {"{\"nodes\":[{\"mesh\":0,\"scale\":[2,1,1]}],", "{}", "stretches or mirrors"},
    {"{\"nodes\":[{\"mesh\":0,\"scale\":[-1,1,1]}],", "{}", "stretches or mirrors"},
    {"{\"nodes\":[{\"mesh\":0,\"scale\":[0,0,0]}],", "{}", "stretches or mirrors"},
    {"{\"nodes\":[{\"mesh\":0,\"rotation\":[0,1]}],", "{}", "stretches or mirrors"},
    {"{\"nodes\":[{\"mesh\":0,\"translation\":[4e6,5e5,5e6]}],", "{}", "as on a globe"},
    {"{\"nodes\":[{\"children\":[0]}],", "{}", "no tree"},
    {"{\"nodes\":[{\"children\":[7]}],", "{}", "no tree"},
    {"{\"nodes\":[{}],", "{}", "0 primitives"},
    {"{\"nodes\":[{\"mesh\":0}],", "{\"kernel\":\"cube\"}", "kernel 'cube'"},
};

/* The file with a case's nodes is the file without, turned, moved and scaled. */
static void stands_as(const struct buf *b, const struct gauss *plain, size_t k)
{
    struct gauss back;
    struct buf out = {0};
    struct err e = {0};
    char text[512];
    static const double turn[9] = {0, 0, 1, 0, 1, 0, -1, 0, 0};
    struct gauss want = {0};
    kit_ok(gauss_alloc(&want, plain->n, plain->sh_degree, 0, &e), e);
    kit_ok(gauss_append(&want, plain, NULL, plain->n, &e), e);
    if (placed[k].turned)
        axes_turn(&want, turn);
    snprintf(text, sizeof text, "%s%s", placed[k].nodes, one);
    with_nodes(b, text, "{}", &out);
    kit_ok(glb_decode(out.data, out.size, NULL, &back, &e), e);
    assert_int_equal(back.n, placed[k].copies * want.n);
    for (size_t i = 0; i < 3 * back.n; i++) {
        const size_t from = i % (3 * want.n);
        const double mean = placed[k].scale * (double)want.mean_m[from] + placed[k].shift[i % 3];
        assert_true(fabs((double)back.mean_m[i] - mean) < 1e-4);
        assert_true(
            fabs((double)(back.scale_log[i] - want.scale_log[from]) - log(placed[k].scale)) < 1e-5);
    }
    for (size_t i = 0; i < 3 * 9 * back.n; i++)
        assert_true(fabsf(back.sh[i] - want.sh[i % (27 * want.n)]) < 1e-4f);
    gauss_free(&back);
    gauss_free(&want);
    buf_free(&out);
}

/* Nodes turn, move and scale; a mesh may stand in several; all primitives are read. */
static void test_nodes_are_applied(void **state)
{
    struct gauss g;
    struct buf b = {0};
    struct err e = {0};
    kit_gauss(5, 20, 10, 2, 0, &g);
    for (int packed = 0; packed < 2; packed++) { /* accessors, and SPZ inside */
        struct quant q = {0};
        b.size = 0;
        kit_ok(quant_from_gauss(&g, 2, NULL, &q, &e), e);
        kit_ok(packed ? glb_encode_spz(&q, NULL, &b, &e) : glb_encode_plain(&g, NULL, &b, &e), e);
        quant_free(&q);
        struct gauss plain;
        kit_ok(glb_decode(b.data, b.size, NULL, &plain, &e), e);
        for (size_t k = 0; k < sizeof placed / sizeof *placed; k++)
            stands_as(&b, &plain, k);
        gauss_free(&plain);
    }
    buf_free(&b);
    gauss_free(&g);
}

/* What cannot be applied is an error that names it. */
static void test_misplaced_nodes_are_named(void **state)
{
    struct gauss g, back;
    struct quant q = {0};
    struct buf b = {0}, out = {0};
    struct err e = {0};
    char text[512];
    const void *spz;
    size_t n_spz;
    kit_gauss(5, 20, 10, 2, 0, &g);
    kit_ok(quant_from_gauss(&g, 2, NULL, &q, &e), e);
    kit_ok(glb_encode_spz(&q, NULL, &b, &e), e);
    for (size_t i = 0; i < sizeof misplaced / sizeof *misplaced; i++) {
        snprintf(text, sizeof text, "%s%s", misplaced[i].nodes, one);
        with_nodes(&b, text, misplaced[i].extra, &out);
        const enum err_code rc = glb_decode(out.data, out.size, NULL, &back, &e);
        assert_true(rc == ERR_FORMAT || rc == ERR_LIMIT);
        assert_non_null(strstr(e.msg, misplaced[i].says));
    }
    /* SPZ bytes are handed out as they are only where nothing happens to them. */
    snprintf(text, sizeof text, "%s%s", placed[1].nodes, one);
    with_nodes(&b, text, "{}", &out);
    kit_fails(glb_find_spz(out.data, out.size, &spz, &n_spz, &e), ERR_NOENT, e, "transformed");
    buf_free(&b);
    buf_free(&out);
    quant_free(&q);
    gauss_free(&g);
}

/* A .glb of this JSON, without binary data. */
static void of_json(const char *json, struct buf *out)
{
    const size_t n = (strlen(json) + 3) & ~(size_t)3;
    out->size = 0;
    buf_u32(out, 0x46546c67);
    buf_u32(out, 2);
    buf_u32(out, (uint32_t)(20 + n));
    buf_u32(out, (uint32_t)n);
    buf_u32(out, 0x4e4f534a);
    buf_printf(out, "%-*s", (int)n, json);
}

/* Drafts of the extensions, which programs of 2025 wrote. */
static void test_drafts_are_named(void **state)
{
    static const char *const drafts[][2] = {
        {"KHR_spz_gaussian_splats_compression",
         "{\"KHR_spz_gaussian_splats_compression\":{\"bufferView\":0}}"},
        {EXT "_compression_spz",
         "{\"" EXT "\":{\"extensions\":{\"" EXT "_compression_spz\":{\"bufferView\":0}}}}"},
    };
    struct buf b = {0};
    for (size_t i = 0; i < sizeof drafts / sizeof *drafts; i++) {
        struct err e = {0};
        struct gauss g;
        char json[800];
        snprintf(json, sizeof json,
                 "{\"asset\":{\"version\":\"2.0\"},\"extensionsUsed\":[\"%s\"],\"scene\":0,"
                 "\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0}],\"buffers\":["
                 "{\"byteLength\":4}],\"bufferViews\":[{\"buffer\":0,\"byteLength\":4}],"
                 "\"accessors\":[{\"componentType\":5126,\"count\":1,\"type\":\"VEC3\"}],"
                 "\"meshes\":[{\"primitives\":[{\"mode\":0,\"attributes\":{\"POSITION\":0},"
                 "\"extensions\":%s}]}]}",
                 drafts[i][0], drafts[i][1]);
        of_json(json, &b);
        kit_fails(glb_decode(b.data, b.size, NULL, &g, &e), ERR_FORMAT, e, drafts[i][0]);
        kit_expect_text(e.msg, "compression_spz_2, or as .spz", __FILE__, __LINE__);
    }
    buf_free(&b);
}

/* Colours in linear light: 0.2 of it is 0.4845 of sRGB. */
static void test_linear_colours_become_srgb(void **state)
{
    const float dc = (0.2f - 0.5f) / (float)GAUSS_SH_C0;
    struct gauss g, back;
    struct buf b = {0}, out = {0};
    struct err e = {0};
    kit_gauss(6, 3, 10, 1, 0, &g);
    for (size_t i = 0; i < 3 * 4 * g.n; i++)
        g.sh[i] = i % 12 < 3 ? dc : 0.1f;
    kit_ok(glb_encode_plain(&g, NULL, &b, &e), e);
    with_nodes(&b, "{\"nodes\":[{\"mesh\":0}],\"scenes\":[{\"nodes\":[0]}]}",
               "{\"colorSpace\":\"lin_rec709_display\"}", &out);
    kit_ok(glb_decode(out.data, out.size, NULL, &back, &e), e);
    const float step = 1e-3f, slope = (1.055f * powf(0.2f + step, 1 / 2.4f) -
                                       1.055f * powf(0.2f - step, 1 / 2.4f)) /
                                      (2 * step);
    for (size_t i = 0; i < 3 * 4 * g.n; i++)
        if (i % 12 < 3)
            assert_true(fabsf(0.5f + (float)GAUSS_SH_C0 * back.sh[i] - 0.48453f) < 1e-4f);
        else
            assert_true(fabsf(back.sh[i] - 0.1f * slope) < 1e-4f);
    gauss_free(&back);
    gauss_free(&g);
    buf_free(&b);
    buf_free(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_spz_form_follows_the_clients),
        cmocka_unit_test(test_plain_form),
        cmocka_unit_test(test_reads_short_and_byte_accessors),
        cmocka_unit_test(test_nodes_are_applied),
        cmocka_unit_test(test_misplaced_nodes_are_named),
        cmocka_unit_test(test_drafts_are_named),
        cmocka_unit_test(test_linear_colours_become_srgb),
        cmocka_unit_test(test_truncation_and_flips),
        cmocka_unit_test(test_refuses_what_cannot_be_written),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
