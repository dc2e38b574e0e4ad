/* .glb with KHR_gaussian_splatting: SPZ v3 inside for 3D Tiles clients, or plain float accessors.
 *
 * The SPZ form is the one that CesiumJS, ArcGIS and 3d-tiles-renderer with Spark were seen to draw:
 * one node, one primitive of mode 0, accessors without data whose count and bounds stand for the
 * payload, COLOR_0 present, SH_DEGREE_0 absent (one name more and Cesium drops all SH), no node
 * transform. The bytes inside are in glTF axes and a correct .spz by themselves. The plain form is
 * for three.js, PlayCanvas and Babylon: linear sigmas and opacities, quaternions x y z w, SH as
 * trained.
 *
 * Read are all primitives with Gaussians, where the nodes put them: turned, moved and scaled alike
 * along all axes. Colours in linear light become sRGB.
 *
 * Sources: glTF 2.0; KHR_gaussian_splatting (ratified);
 * KHR_gaussian_splatting_compression_spz_2 (draft).
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/glb.h"
#include "codec/limits.h"
#include "codec/splat/axes.h"
#include "codec/splat/glb_nodes.h"
#include "codec/splat/quant.h"
#include "codec/splat/spz.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAGIC = 0x46546c67,
    CHUNK_JSON = 0x4e4f534a,
    CHUNK_BIN = 0x004e4942,
    FLOAT32 = 5126,
    UINT8 = 5121,
    INT16 = 5122,
    UINT16 = 5123,
    GLB_HEAD_BYTES = 12,
};
#define EXT_SPLAT GLB_SPLAT
#define EXT_SPZ GLB_SPZ

/* ---- writing ---- */

static enum err_code glb_pack(json_t *root, const struct buf *bin, struct buf *out, struct err *e)
{
    char *text = json_dumps(root, JSON_COMPACT | JSON_REAL_PRECISION(17));
    if (!text)
        return err_set(e, ERR_ARG, "glb: the text given for it is not UTF-8, or out of memory");
    size_t n = strlen(text), n_json = (n + 3) & ~(size_t)3, n_bin = (bin->size + 3) & ~(size_t)3;
    size_t total = GLB_HEAD_BYTES + 8 + n_json + 8 + n_bin;
    enum err_code rc = ERR_OK;
    if (total > UINT32_MAX) {
        rc = err_set(e, ERR_LIMIT, "glb: %zu bytes: at most 4 GiB fit, cut the scene into tiles",
                     total);
    } else {
        buf_u32(out, MAGIC);
        buf_u32(out, 2);
        buf_u32(out, (uint32_t)total);
        buf_u32(out, (uint32_t)n_json);
        buf_u32(out, CHUNK_JSON);
        buf_add(out, text, n);
        buf_add(out, "   ", n_json - n);
        buf_u32(out, (uint32_t)n_bin);
        buf_u32(out, CHUNK_BIN);
        buf_add(out, bin->data, bin->size);
        buf_add(out, "\0\0\0", n_bin - bin->size);
        rc = buf_check(out, e);
    }
    free(text);
    return rc;
}

static json_t *glb_accessor(size_t count, int component, const char *type)
{
    return json_pack("{s:I,s:i,s:s}", "count", (json_int_t)count, "componentType", component,
                     "type", type);
}

static int glb_set_bounds(json_t *position, const double lo[3], const double hi[3])
{
    return json_object_set_new(position, "min", json_pack("[f,f,f]", lo[0], lo[1], lo[2])) |
           json_object_set_new(position, "max", json_pack("[f,f,f]", hi[0], hi[1], hi[2]));
}

/* {asset, scene, nodes, meshes: [{primitives: [{mode 0, attributes, extensions}]}], extensionsUsed,
 * ...} around accessors, bufferViews and the primitive's extension, whose references it takes. */
static json_t *glb_document(const char *copyright, json_t *attributes, json_t *accessors,
                            json_t *views, size_t n_bytes, json_t *splat, bool spz)
{
    json_t *asset =
        json_pack("{s:s,s:s,s:s*}", "version", "2.0", "generator", "citysplat " CITYSPLAT_VERSION,
                  "copyright", copyright && *copyright ? copyright : NULL);
    json_t *used = spz ? json_pack("[s,s]", EXT_SPLAT, EXT_SPZ) : json_pack("[s]", EXT_SPLAT);
    json_t *prim = json_pack("{s:i,s:o,s:{s:o}}", "mode", 0, "attributes", attributes, "extensions",
                             EXT_SPLAT, splat);
    json_t *root =
        json_pack("{s:o,s:i,s:[{s:[i]}],s:[{s:i}],s:[{s:[o]}],s:o,s:o,s:[{s:I}],s:o}", "asset",
                  asset, "scene", 0, "scenes", "nodes", 0, "nodes", "mesh", 0, "meshes",
                  "primitives", prim, "accessors", accessors, "bufferViews", views, "buffers",
                  "byteLength", (json_int_t)n_bytes, "extensionsUsed", used);
    /* Without the decoder nothing can be drawn; a plain file shows at least points. */
    if (root && spz)
        json_object_set_new(root, "extensionsRequired", json_pack("[s,s]", EXT_SPLAT, EXT_SPZ));
    return root;
}

static json_t *glb_splat_extension(void)
{
    return json_pack("{s:s,s:s,s:s,s:s}", "kernel", "ellipse", "colorSpace", "srgb_rec709_display",
                     "sortingMethod", "cameraDistance", "projection", "perspective");
}

static void glb_add_attribute(json_t *attributes, json_t *accessors, const char *name, json_t *a)
{
    json_object_set_new(attributes, name, json_integer((json_int_t)json_array_size(accessors)));
    json_array_append_new(accessors, a);
}

static const char *glb_sh_name(char name[64], uint32_t degree, uint32_t coef)
{
    snprintf(name, 64, EXT_SPLAT ":SH_DEGREE_%u_COEF_%u", degree, coef);
    return name;
}

enum err_code glb_encode_spz(const struct quant *q, const char *copyright, struct buf *out,
                             struct err *e)
{
    struct buf spz = {0};
    json_t *root = NULL;
    char name[64];
    if (!q->n)
        return err_set(e, ERR_DATA, "glb: no Gaussians: a glTF accessor cannot be empty");
    enum err_code rc = spz_encode(q, 3, &spz, e);
    if (rc)
        goto out;
    double lo[3], hi[3];
    for (int c = 0; c < 3; c++) { /* exactly what a reader dequantises */
        int32_t a = q->position[c], b = a;
        for (size_t i = 1; i < q->n; i++) {
            a = q->position[3 * i + c] < a ? q->position[3 * i + c] : a;
            b = q->position[3 * i + c] > b ? q->position[3 * i + c] : b;
        }
        lo[c] = ldexp(a, -(int)q->frac_bits);
        hi[c] = ldexp(b, -(int)q->frac_bits);
    }
    json_t *attributes = json_object(), *accessors = json_array(),
           *position = glb_accessor(q->n, FLOAT32, "VEC3");
    json_t *color = glb_accessor(q->n, UINT8, "VEC4");
    glb_set_bounds(position, lo, hi);
    json_object_set_new(color, "normalized", json_true());
    glb_add_attribute(attributes, accessors, "POSITION", position);
    glb_add_attribute(attributes, accessors, "COLOR_0", color);
    glb_add_attribute(attributes, accessors, EXT_SPLAT ":SCALE",
                      glb_accessor(q->n, FLOAT32, "VEC3"));
    glb_add_attribute(attributes, accessors, EXT_SPLAT ":ROTATION",
                      glb_accessor(q->n, FLOAT32, "VEC4"));
    for (uint32_t l = 1; l <= q->sh_degree; l++)
        for (uint32_t m = 0; m <= 2 * l; m++)
            glb_add_attribute(attributes, accessors, glb_sh_name(name, l, m),
                              glb_accessor(q->n, FLOAT32, "VEC3"));
    json_t *splat = glb_splat_extension();
    json_object_set_new(splat, "extensions", json_pack("{s:{s:i}}", EXT_SPZ, "bufferView", 0));
    json_t *views = json_pack("[{s:i,s:i,s:I}]", "buffer", 0, "byteOffset", 0, "byteLength",
                              (json_int_t)spz.size);
    root = glb_document(copyright, attributes, accessors, views, spz.size, splat, true);
    rc = root ? glb_pack(root, &spz, out, e)
              : err_set(e, ERR_ARG, "glb: the copyright text is not UTF-8, or out of memory");
out:
    json_decref(root);
    buf_free(&spz);
    return rc;
}

/* ---- plain: one accessor, one view, one run of floats an attribute ---- */

struct plain {
    const struct gauss *g;
    json_t *attributes, *accessors, *views;
    struct buf bin;
};

/* Rows of `width` floats, each of them to be set. NULL: no memory, which the buffer remembers. */
static float *glb_plain_add(struct plain *p, const char *name, size_t width, json_t **made)
{
    static const char *const type[] = {"", "SCALAR", "VEC2", "VEC3", "VEC4"};
    size_t bytes = p->g->n * width * sizeof(float);
    json_t *a = glb_accessor(p->g->n, FLOAT32, type[width]);
    json_t *view =
        json_pack("{s:i,s:I,s:I,s:i}", "buffer", 0, "byteOffset", (json_int_t)p->bin.size,
                  "byteLength", (json_int_t)bytes, "target", 34962); /* ARRAY_BUFFER */
    json_object_set_new(a, "bufferView", json_integer((json_int_t)json_array_size(p->views)));
    json_array_append_new(p->views, view);
    glb_add_attribute(p->attributes, p->accessors, name, a);
    if (made)
        *made = a;
    return (float *)(void *)buf_grow(&p->bin, bytes); /* a multiple of 4 bytes from its start */
}

static float glb_linear_from_srgb(float v)
{
    v = v < 0 ? 0 : v > 1 ? 1 : v;
    return v <= 0.04045f ? v / 12.92f : powf((v + 0.055f) / 1.055f, 2.4f);
}

static float glb_opacity(const struct gauss *g, size_t i)
{
    return 1 / (1 + expf(-g->opacity_logit[i]));
}

static void glb_plain_fill_sh(struct plain *p)
{
    const struct gauss *g = p->g;
    size_t k = gauss_sh_count(g->sh_degree), at = 0;
    char name[64];
    for (uint32_t l = 0; l <= g->sh_degree; l++)
        for (uint32_t m = 0; m <= 2 * l; m++, at++) {
            float *to = glb_plain_add(p, glb_sh_name(name, l, m), 3, NULL);
            for (size_t i = 0; to && i < g->n; i++)
                memcpy(to + 3 * i, g->sh + 3 * (i * k + at), 12);
        }
}

/* For viewers without the extension: points, in linear colour. */
static void glb_plain_fill_color(struct plain *p)
{
    const struct gauss *g = p->g;
    size_t k = gauss_sh_count(g->sh_degree);
    float *to = glb_plain_add(p, "COLOR_0", 4, NULL);
    for (size_t i = 0; to && i < g->n; i++)
        for (size_t c = 0; c < 4; c++)
            *to++ = c < 3 ? glb_linear_from_srgb((float)GAUSS_SH_C0 * g->sh[3 * k * i + c] + 0.5f)
                          : glb_opacity(g, i);
}

static void glb_plain_fill_shape(struct plain *p)
{
    const struct gauss *g = p->g;
    float *to = glb_plain_add(p, EXT_SPLAT ":SCALE", 3, NULL);
    for (size_t i = 0; to && i < 3 * g->n; i++)
        to[i] = expf(g->scale_log[i]);
    to = glb_plain_add(p, EXT_SPLAT ":ROTATION", 4, NULL);
    for (size_t i = 0; to && i < g->n; i++) {
        const float *q = g->quat_wxyz + 4 * i;
        float norm = sqrtf(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
        for (size_t c = 0; c < 4; c++)
            *to++ = q[(c + 1) % 4] / norm;
    }
    to = glb_plain_add(p, EXT_SPLAT ":OPACITY", 1, NULL);
    for (size_t i = 0; to && i < g->n; i++)
        to[i] = glb_opacity(g, i);
}

static void glb_plain_fill(struct plain *p)
{
    const struct gauss *g = p->g;
    double lo[3], hi[3];
    json_t *position;
    float *to = glb_plain_add(p, "POSITION", 3, &position);
    for (size_t i = 0; to && i < 3 * g->n; i++) {
        double v = (double)(to[i] = g->mean_m[i]);
        lo[i % 3] = i < 3 || v < lo[i % 3] ? v : lo[i % 3];
        hi[i % 3] = i < 3 || v > hi[i % 3] ? v : hi[i % 3];
    }
    if (to)
        glb_set_bounds(position, lo, hi);
    glb_plain_fill_color(p);
    glb_plain_fill_shape(p);
    glb_plain_fill_sh(p);
}

enum err_code glb_encode_plain(const struct gauss *g, const char *copyright, struct buf *out,
                               struct err *e)
{
    struct plain p = {.g = g};
    size_t bad = 0;
    if (!g->n)
        return err_set(e, ERR_DATA, "glb: no Gaussians: a glTF accessor cannot be empty");
    if (gauss_count_bad(g, &bad))
        return err_set(e, ERR_DATA, "glb: row %zu: not finite, or no rotation", bad);
    p.attributes = json_object();
    p.accessors = json_array();
    p.views = json_array();
    glb_plain_fill(&p);
    json_t *root = glb_document(copyright, p.attributes, p.accessors, p.views, p.bin.size,
                                glb_splat_extension(), false);
    enum err_code rc = buf_check(&p.bin, e);
    if (!rc && !root)
        rc = err_set(e, ERR_ARG, "glb: the copyright text is not UTF-8, or out of memory");
    if (!rc)
        rc = glb_pack(root, &p.bin, out, e);
    json_decref(root);
    buf_free(&p.bin);
    return rc;
}

/* ---- reading ---- */

static const double glb_far_m = 1e5; /* float32 coordinates are right to a centimetre up to here */

static size_t glb_component_bytes(int component)
{
    return component == FLOAT32                        ? 4
           : component == INT16 || component == UINT16 ? 2
           : component == 5120 || component == UINT8   ? 1
                                                       : 0;
}

struct glb {
    json_t *root;
    const json_t *primitive, *splat; /* borrowed from root */
    const uint8_t *bin;
    size_t n_bin;
};

/* f->root is json_decref'd by the caller, also on failure. */
static enum err_code glb_open(const void *bytes, size_t n, struct glb *f, struct err *e)
{
    struct cursor c = cursor_over(bytes, n);
    uint32_t magic = cursor_u32(&c), version = cursor_u32(&c), total = cursor_u32(&c);
    uint32_t n_json = cursor_u32(&c), type = cursor_u32(&c);
    if (c.bad || magic != MAGIC)
        return err_set(e, ERR_FORMAT, "glb: not a binary glTF file, or truncated in its header");
    const uint8_t *text = cursor_take(&c, n_json);
    if (version != 2 || total != n || type != CHUNK_JSON || !text)
        return err_set(e, ERR_FORMAT,
                       "glb: version %u, %u bytes announced, %zu there: damaged or truncated",
                       version, total, n);
    if (cursor_left(&c)) {
        uint32_t n_bin = cursor_u32(&c);
        type = cursor_u32(&c);
        f->n_bin = n_bin;
        f->bin = cursor_take(&c, n_bin);
        if (!f->bin || type != CHUNK_BIN)
            return err_set(e, ERR_FORMAT, "glb: binary chunk is damaged or truncated");
    }
    return jsonc_parse((const char *)text, n_json, "glb", &f->root, e);
}

static bool glb_is_linear(const json_t *splat)
{
    const char *space = json_string_value(json_object_get(splat, "colorSpace"));
    return space && !strcmp(space, "lin_rec709_display");
}

static bool glb_is_usual(const json_t *splat)
{
    const char *kernel = json_string_value(json_object_get(splat, "kernel")),
               *space = json_string_value(json_object_get(splat, "colorSpace"));
    return (!kernel || !strcmp(kernel, "ellipse")) &&
           (!space || !strcmp(space, "srgb_rec709_display"));
}

static bool glb_is_plain_place(const struct glb_place *p)
{
    static const double one[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1};
    bool same = p->scale == 1;
    for (size_t k = 0; k < 9; k++)
        same = same && p->rot[k] == one[k] && p->shift[k / 3] == 0;
    return same;
}

static bool glb_view_bytes(const struct glb *f, const json_t *view, size_t *at, size_t *n)
{
    const json_t *offset = json_object_get(view, "byteOffset"),
                 *len = json_object_get(view, "byteLength");
    json_int_t o = offset ? json_integer_value(offset) : 0, l = json_integer_value(len);
    if (!view || json_integer_value(json_object_get(view, "buffer")) || o < 0 || l < 0 ||
        (uint64_t)o > f->n_bin || (uint64_t)l > f->n_bin - (uint64_t)o)
        return false;
    *at = (size_t)o;
    *n = (size_t)l;
    return true;
}

static enum err_code glb_seek_spz(const struct glb *f, const void **spz, size_t *n_spz,
                                  struct err *e)
{
    const json_t *ext = json_object_get(json_object_get(f->splat, "extensions"), EXT_SPZ);
    size_t at;
    if (!ext)
        return err_set(e, ERR_NOENT,
                       "glb: no " EXT_SPZ " inside: its Gaussians are plain accessors");
    if (!glb_view_bytes(f, glb_array_at(f->root, "bufferViews", json_object_get(ext, "bufferView")),
                        &at, n_spz))
        return err_set(e, ERR_FORMAT, "glb: the SPZ payload's bufferView does not fit the file");
    *spz = f->bin + at;
    return ERR_OK;
}

enum err_code glb_find_spz(const void *bytes, size_t n, const void **spz, size_t *n_spz,
                           struct err *e)
{
    struct glb f = {0};
    struct glb_places places = {0};
    enum err_code rc = glb_open(bytes, n, &f, e);
    if (!rc)
        rc = glb_places_find(f.root, &places, e);
    if (!rc &&
        (places.n > 1 || !glb_is_plain_place(places.list) || !glb_is_usual(places.list->splat)))
        rc = err_set(e, ERR_NOENT, "glb: its Gaussians are of several primitives, or transformed");
    if (!rc) {
        f.primitive = places.list->primitive;
        f.splat = places.list->splat;
        rc = glb_seek_spz(&f, spz, n_spz, e);
    }
    mem_free(places.list);
    json_decref(f.root);
    return rc;
}

struct values { /* an accessor, checked to hold count rows of width */
    const uint8_t *p;
    size_t count, stride;
    int component;
    bool normalized;
};

static enum err_code glb_values_find(const struct glb *f, const char *name, size_t width,
                                     struct values *v, struct err *e)
{
    const json_t *index = json_object_get(json_object_get(f->primitive, "attributes"), name);
    const json_t *a = glb_array_at(f->root, "accessors", index);
    const json_t *view = glb_array_at(f->root, "bufferViews", json_object_get(a, "bufferView"));
    const char *type = json_string_value(json_object_get(a, "type"));
    const char *want = width == 1 ? "SCALAR" : width == 3 ? "VEC3" : "VEC4";
    json_int_t count = json_integer_value(json_object_get(a, "count"));
    json_int_t offset = json_integer_value(json_object_get(a, "byteOffset"));
    json_int_t stride = json_integer_value(json_object_get(view, "byteStride"));
    size_t at, n;
    if (!a)
        return err_set(e, ERR_FORMAT, "glb: attribute %s is missing", name);
    *v = (struct values){.component = (int)json_integer_value(json_object_get(a, "componentType")),
                         .normalized = json_is_true(json_object_get(a, "normalized"))};
    size_t row = glb_component_bytes(v->component) * width;
    if (!row || !type || strcmp(type, want) || json_object_get(a, "sparse") ||
        !glb_view_bytes(f, view, &at, &n) || count < 1 || offset < 0 || stride < 0 ||
        stride > 252 || (stride && (size_t)stride < row) || (uint64_t)offset > n ||
        n - (size_t)offset < row)
        return err_set(e, ERR_FORMAT,
                       "glb: attribute %s: its accessor is not of a kind that can be read", name);
    v->stride = stride ? (size_t)stride : row;
    if ((uint64_t)count - 1 > (n - (size_t)offset - row) / v->stride)
        return err_set(e, ERR_FORMAT, "glb: attribute %s: %lld rows do not fit its bufferView",
                       name, (long long)count);
    v->count = (size_t)count;
    v->p = f->bin + at + offset;
    return ERR_OK;
}

static float glb_value_get(const struct values *v, size_t row, size_t c)
{
    const uint8_t *p = v->p + row * v->stride + c * glb_component_bytes(v->component);
    uint32_t u16 = glb_component_bytes(v->component) == 2 ? p[0] | (uint32_t)p[1] << 8 : 0;
    float f;
    switch (v->component) {
    case FLOAT32:
        memcpy(&f, p, 4);
        return f;
    case 5120:
        f = (float)(int8_t)p[0];
        return v->normalized ? fmaxf(f / 127, -1) : f;
    case UINT8:
        return v->normalized ? (float)p[0] / 255 : (float)p[0];
    case INT16:
        f = (float)(int16_t)u16;
        return v->normalized ? fmaxf(f / 32767, -1) : f;
    default:
        return v->normalized ? (float)u16 / 65535 : (float)u16;
    }
}

static enum err_code glb_values_read(const struct glb *f, const char *name, size_t n, size_t width,
                                     float *out, size_t out_stride, struct err *e)
{
    struct values v;
    enum err_code rc = glb_values_find(f, name, width, &v, e);
    if (!rc && v.count != n)
        rc = err_set(e, ERR_FORMAT, "glb: attribute %s: %zu rows, POSITION has %zu", name, v.count,
                     n);
    for (size_t i = 0; !rc && i < n; i++)
        for (size_t c = 0; c < width; c++)
            out[i * out_stride + c] = glb_value_get(&v, i, c);
    return rc;
}

/* Linear values of the file to the container's logs and logits; sigma 0 and opacity 0 or 1 become
 * finite. */
static void glb_from_linear(struct gauss *g)
{
    for (size_t i = 0; i < 3 * g->n; i++)
        g->scale_log[i] = logf(g->scale_log[i] < 1e-9f ? 1e-9f : g->scale_log[i]);
    for (size_t i = 0; i < g->n; i++) {
        float a = g->opacity_logit[i], *q = g->quat_wxyz + 4 * i;
        float w = q[3];                                        /* from x y z w */
        a = a < 1e-6f ? 1e-6f : a > 1 - 1e-6f ? 1 - 1e-6f : a; /* NaN stays, and is left out */
        g->opacity_logit[i] = logf(a / (1 - a));
        q[3] = q[2];
        q[2] = q[1];
        q[1] = q[0];
        q[0] = w;
    }
}

static enum err_code glb_decode_plain(const struct glb *f, const struct codec_limits *lim,
                                      struct gauss *out, struct err *e)
{
    struct values position = {0};
    char name[64];
    uint32_t degree = 0;
    size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    const json_t *attributes = json_object_get(f->primitive, "attributes");
    enum err_code rc = glb_values_find(f, "POSITION", 3, &position, e);
    if (rc)
        return rc;
    size_t n = position.count; /* no more than the file holds */
    if (n > most)
        return err_set(e, ERR_LIMIT, "glb: %zu Gaussians: the limit is %zu", n, most);
    while (degree < GAUSS_SH_DEGREE_MAX &&
           json_object_get(attributes, glb_sh_name(name, degree + 1, 0)))
        degree++;
    rc = gauss_alloc(out, n, degree, 0, e);
    if (rc)
        return rc;
    out->n = n;
    size_t row = 3 * gauss_sh_count(degree), at = 0;
    rc = glb_values_read(f, "POSITION", n, 3, out->mean_m, 3, e);
    if (!rc)
        rc = glb_values_read(f, EXT_SPLAT ":SCALE", n, 3, out->scale_log, 3, e);
    if (!rc)
        rc = glb_values_read(f, EXT_SPLAT ":ROTATION", n, 4, out->quat_wxyz, 4, e);
    if (!rc)
        rc = glb_values_read(f, EXT_SPLAT ":OPACITY", n, 1, out->opacity_logit, 1, e);
    for (uint32_t l = 0; l <= degree; l++)
        for (uint32_t m = 0; !rc && m <= 2 * l; m++, at += 3)
            rc = glb_values_read(f, glb_sh_name(name, l, m), n, 3, out->sh + at, row, e);
    if (!rc) {
        glb_from_linear(out);
        rc = gauss_keep_good(out, "glb", e);
    }
    if (rc)
        gauss_free(out);
    return rc;
}

/* Of f->primitive, as it lies in the file. */
static enum err_code glb_decode_one(const struct glb *f, const struct codec_limits *lim,
                                    struct gauss *out, struct err *e)
{
    struct quant q = {0};
    const void *spz = NULL;
    size_t n_spz = 0;
    json_t *inside = json_object_get(f->splat, "extensions");
    if (!json_object_get(inside, EXT_SPZ)) {
        const char *other = json_object_iter_key(json_object_iter(inside));
        const json_t *attributes = json_object_get(f->primitive, "attributes");
        return other && !json_object_get(attributes, EXT_SPLAT ":SCALE")
                   ? glb_other_extension(other, e)
                   : glb_decode_plain(f, lim, out, e);
    }
    enum err_code rc = glb_seek_spz(f, &spz, &n_spz, e);
    if (!rc)
        rc = spz_decode(spz, n_spz, lim, &q, e);
    if (!rc)
        rc = quant_to_gauss(&q, out, e);
    quant_free(&q);
    return rc;
}

/* Colours that were trained in linear light, as sRGB: the mean exactly, what depends on the
 * direction to first order. */
static void glb_to_srgb(struct gauss *g)
{
    const size_t k = gauss_sh_count(g->sh_degree);
    for (size_t i = 0; i < 3 * g->n; i++) {
        float *sh = g->sh + i / 3 * 3 * k + i % 3;
        const float v = fminf(fmaxf((float)GAUSS_SH_C0 * sh[0] + 0.5f, 0), 1);
        const bool low = v <= 0.0031308f;
        const float srgb = low ? 12.92f * v : 1.055f * powf(v, 1 / 2.4f) - 0.055f,
                    slope = low ? 12.92f : 1.055f / 2.4f * powf(v, 1 / 2.4f - 1);
        sh[0] = (srgb - 0.5f) / (float)GAUSS_SH_C0;
        for (size_t m = 1; m < k; m++)
            sh[3 * m] *= slope;
    }
}

static enum err_code glb_put_place(struct gauss *g, const struct glb_place *at, struct err *e)
{
    const char *kernel = json_string_value(json_object_get(at->splat, "kernel")),
               *space = json_string_value(json_object_get(at->splat, "colorSpace"));
    if (kernel && strcmp(kernel, "ellipse"))
        return err_set(e, ERR_FORMAT, "glb: kernel '%.40s': 'ellipse' is read", kernel);
    if (space && strcmp(space, "srgb_rec709_display") && !glb_is_linear(at->splat))
        log_warn("glb", "colour space '%.40s' is not known: taken as srgb_rec709_display", space);
    if (glb_is_linear(at->splat)) {
        log_info("glb", "colours are linear: made sRGB");
        glb_to_srgb(g);
    }
    if (glb_is_plain_place(at))
        return ERR_OK;
    for (size_t k = 0; k < 3; k++)
        if (!(fabs(at->shift[k]) < glb_far_m))
            return err_set(
                e, ERR_LIMIT,
                "glb: a node is moved by %.0f m, as on a globe: at most %.0f km are read",
                at->shift[k], 1e-3 * glb_far_m);
    axes_turn(g, at->rot);
    for (size_t i = 0; i < 3 * g->n; i++) {
        g->mean_m[i] = (float)(at->scale * (double)g->mean_m[i] + at->shift[i % 3]);
        g->scale_log[i] += (float)log(at->scale);
    }
    return ERR_OK;
}

/* Appends g, at the higher degree of the two. */
static enum err_code glb_join(struct gauss *all, const struct gauss *g, struct err *e)
{
    struct gauss wide = {0};
    enum err_code rc = ERR_OK;
    const size_t left_out = all->n_left_out + g->n_left_out;
    if (g->sh_degree > all->sh_degree) {
        rc = gauss_alloc(&wide, all->n, g->sh_degree, 0, e);
        if (!rc)
            rc = gauss_append(&wide, all, NULL, all->n, e);
        wide.antialiased = all->antialiased;
        gauss_free(all);
        *all = wide;
    }
    if (!rc)
        rc = gauss_append(all, g, NULL, g->n, e);
    all->n_left_out = left_out;
    return rc;
}

enum err_code glb_decode(const void *bytes, size_t n, const struct codec_limits *lim,
                         struct gauss *out, struct err *e)
{
    struct glb f = {0};
    struct glb_places places = {0};
    const size_t most = lim && lim->max_gaussians ? lim->max_gaussians : CODEC_MAX_GAUSSIANS;
    *out = (struct gauss){0};
    enum err_code rc = glb_open(bytes, n, &f, e);
    if (!rc)
        rc = glb_places_find(f.root, &places, e);
    for (size_t i = 0; !rc && i < places.n; i++) {
        struct gauss g = {0};
        f.primitive = places.list[i].primitive;
        f.splat = places.list[i].splat;
        rc = glb_decode_one(&f, lim, i ? &g : out, e);
        if (!rc)
            rc = glb_put_place(i ? &g : out, &places.list[i], e);
        if (!rc && i && g.n > most - out->n)
            rc = err_set(e, ERR_LIMIT, "glb: %zu Gaussians: the limit is %zu", out->n + g.n, most);
        if (!rc && i)
            rc = glb_join(out, &g, e);
        gauss_free(&g);
    }
    if (rc)
        gauss_free(out);
    mem_free(places.list);
    json_decref(f.root);
    return rc;
}
