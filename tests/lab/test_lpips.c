/* LPIPS: toy networks of the topology of VGG16 and AlexNet with a few random channels, against
 * plain loops in double; and hostile .safetensors files.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "lab/eval/lpips.h"
#include "lab/eval/tensors.h"
#include "tests/codec/torture.h"
#include "tests/kit.h"

#define TOLERANCE 1e-4 /* relative: thirteen layers in float */

static struct dev *dev_get(void)
{
    static struct dev d;
    static bool open;
    struct err e = {0};
    if (!open)
        kit_ok(dev_open("auto", &d, &e), e);
    open = true;
    return &d;
}

/* ---- a toy network ---- */

struct toy_layer {
    int index, slice, cout, k, stride, pad, pool_k, tap; /* tap: -1 none */
    float *w, *b, *lin;
};
struct toy {
    struct toy_layer layer[13];
    size_t n;
};

/* Topologies written down once more, from the papers: 13 convolutions of 3 x 3 in blocks of 2, 2,
 * 3, 3, 3 with a 2 x 2 maximum between blocks (Simonyan 2015); 11, 5, 3, 3, 3 with overlapping
 * maxima of 3 x 3 (Krizhevsky 2012, torchvision's variant). Channels are not multiples of 8 on
 * purpose. */
static struct toy toy_make(bool vgg, bool full)
{
    static const int in_block[5] = {2, 2, 3, 3, 3}, kernel[5] = {11, 5, 3, 3, 3};
    static const int channels[5] = {5, 9, 8, 17, 6}, alex_index[5] = {0, 3, 6, 8, 10};
    static const int vgg_full[5] = {64, 128, 256, 512, 512},
                     alex_full[5] = {64, 192, 384, 256, 256};
    struct toy t = {.n = 0};
    int cin = 3, index = 0;
    for (int b = 0; b < 5; b++)
        for (int i = 0; i < (vgg ? in_block[b] : 1); i++) {
            struct toy_layer *y = &t.layer[t.n];
            bool last = i + 1 == in_block[b];
            y->slice = b + 1;
            y->cout = !full ? channels[b] + i : vgg ? vgg_full[b] : alex_full[b];
            y->k = vgg ? 3 : kernel[b];
            y->stride = !vgg && b == 0 ? 4 : 1;
            y->pad = vgg ? 1 : b < 2 ? 2 : 1;
            y->pool_k = vgg ? (b > 0 && i == 0 ? 2 : 0) : b == 1 || b == 2 ? 3 : 0;
            index += vgg && b > 0 && i == 0; /* the maximum counts as a layer */
            y->index = vgg ? index : alex_index[b];
            index += 2;
            y->tap = vgg ? (last ? b : -1) : b;
            size_t n = (size_t)(y->cout * cin * y->k * y->k);
            y->w = mem_array(n, sizeof *y->w);
            y->b = mem_array((size_t)y->cout, sizeof *y->b);
            y->lin = mem_array((size_t)y->cout, sizeof *y->lin);
            assert_true(y->w && y->b && y->lin);
            for (size_t j = 0; j < n; j++)
                y->w[j] = (float)(rng_normal(3, t.n, j) / sqrt((double)n / y->cout));
            for (size_t j = 0; j < (size_t)y->cout; j++) {
                y->b[j] = (float)(0.1 * rng_normal(4, t.n, j));
                y->lin[j] = (float)rng_unit(5, t.n, j);
            }
            cin = y->cout;
            t.n++;
        }
    return t;
}

static void toy_free(struct toy *t)
{
    for (size_t i = 0; i < t->n; i++) {
        mem_free(t->layer[i].w);
        mem_free(t->layer[i].b);
        mem_free(t->layer[i].lin);
    }
}

static void toy_tensor(struct buf *head, struct buf *data, const char *name, const char *shape,
                       const float *v, size_t n)
{
    buf_printf(head, "%s\"%s\":{\"dtype\":\"F32\",\"shape\":[%s],\"data_offsets\":[%zu,%zu]}",
               head->size ? "," : "{", name, shape, data->size, data->size + n * sizeof *v);
    buf_add(data, v, n * sizeof *v);
}

/* The file as the authors' program would save it; `skip`: leave out this tensor. */
static void toy_write(const struct toy *t, const char *skip, struct buf *out)
{
    struct buf head = {0}, data = {0};
    char name[64], shape[64];
    int cin = 3;
    for (size_t i = 0; i < t->n; i++) {
        const struct toy_layer *y = &t->layer[i];
        snprintf(name, sizeof name, "net.slice%d.%d.weight", y->slice, y->index);
        snprintf(shape, sizeof shape, "%d,%d,%d,%d", y->cout, cin, y->k, y->k);
        if (!skip || strcmp(skip, name))
            toy_tensor(&head, &data, name, shape, y->w, (size_t)(y->cout * cin * y->k * y->k));
        snprintf(name, sizeof name, "net.slice%d.%d.bias", y->slice, y->index);
        snprintf(shape, sizeof shape, "%d", y->cout);
        toy_tensor(&head, &data, name, shape, y->b, (size_t)y->cout);
        snprintf(name, sizeof name, "lin%d.model.1.weight", y->tap);
        snprintf(shape, sizeof shape, "1,%d,1,1", y->cout);
        if (y->tap >= 0 && (!skip || strcmp(skip, name)))
            toy_tensor(&head, &data, name, shape, y->lin, (size_t)y->cout);
        cin = y->cout;
    }
    buf_printf(&head, ",\"__metadata__\":{\"format\":\"pt\"}}");
    buf_u64(out, head.size);
    buf_add(out, head.data, head.size);
    buf_add(out, data.data, data.size);
    assert_false(out->failed);
    buf_free(&head);
    buf_free(&data);
}

/* ---- the same in plain loops ---- */

struct plain {
    double *v;
    int c, w, h;
};

static struct plain plain_make(int c, int w, int h)
{
    struct plain p = {mem_array((size_t)(c * w * h), sizeof(double)), c, w, h};
    assert_non_null(p.v);
    return p;
}

static double plain_at(const struct plain *p, int c, int x, int y)
{
    return x < 0 || y < 0 || x >= p->w || y >= p->h ? 0.0 : p->v[(c * p->h + y) * p->w + x];
}

static struct plain plain_pool(struct plain in, int k)
{
    struct plain out = plain_make(in.c, (in.w - k) / 2 + 1, (in.h - k) / 2 + 1);
    for (int c = 0; c < out.c; c++)
        for (int y = 0; y < out.h; y++)
            for (int x = 0; x < out.w; x++) {
                double best = -HUGE_VAL;
                for (int i = 0; i < k * k; i++)
                    best = fmax(best, plain_at(&in, c, 2 * x + i % k, 2 * y + i / k));
                out.v[(c * out.h + y) * out.w + x] = best;
            }
    mem_free(in.v);
    return out;
}

static struct plain plain_conv(struct plain in, const struct toy_layer *l)
{
    struct plain out = plain_make(l->cout, (in.w + 2 * l->pad - l->k) / l->stride + 1,
                                  (in.h + 2 * l->pad - l->k) / l->stride + 1);
    for (int o = 0; o < out.c; o++)
        for (int y = 0; y < out.h; y++)
            for (int x = 0; x < out.w; x++) {
                double sum = (double)l->b[o];
                for (int c = 0; c < in.c; c++)
                    for (int i = 0; i < l->k * l->k; i++)
                        sum += (double)l->w[(o * in.c + c) * l->k * l->k + i] *
                               plain_at(&in, c, x * l->stride - l->pad + i % l->k,
                                        y * l->stride - l->pad + i / l->k);
                out.v[(o * out.h + y) * out.w + x] = fmax(sum, 0.0);
            }
    mem_free(in.v);
    return out;
}

static double plain_distance(const struct plain *a, const struct plain *b, const float *lin)
{
    double total = 0.0;
    size_t n = (size_t)(a->w * a->h);
    for (size_t i = 0; i < n; i++) {
        double aa = 0.0, bb = 0.0;
        for (size_t c = 0; c < (size_t)a->c; c++) {
            aa += a->v[c * n + i] * a->v[c * n + i];
            bb += b->v[c * n + i] * b->v[c * n + i];
        }
        for (size_t c = 0; c < (size_t)a->c; c++) {
            double d = a->v[c * n + i] / (sqrt(aa) + 1e-10) - b->v[c * n + i] / (sqrt(bb) + 1e-10);
            total += (double)lin[c] * d * d;
        }
    }
    return total / (double)n;
}

static double plain_lpips(const struct toy *t, const float *rgb, const uint8_t *target,
                          const uint8_t *mask, int w, int h, bool unit)
{
    static const double shift[3] = {-0.030, -0.088, -0.188}, scale[3] = {0.458, 0.448, 0.450};
    struct plain a = plain_make(3, w, h), b = plain_make(3, w, h);
    double total = 0.0;
    for (int i = 0; i < 3 * w * h; i++) {
        int c = i % 3, at = c * w * h + i / 3;
        bool used = !mask || mask[i / 3];
        double x = used ? fmin(fmax((double)rgb[i], 0.0), 1.0) : 0.0;
        double y = used ? target[i] / 255.0 : 0.0;
        a.v[at] = ((unit ? x : 2.0 * x - 1.0) - shift[c]) / scale[c];
        b.v[at] = ((unit ? y : 2.0 * y - 1.0) - shift[c]) / scale[c];
    }
    for (size_t i = 0; i < t->n; i++) {
        const struct toy_layer *l = &t->layer[i];
        if (l->pool_k) {
            a = plain_pool(a, l->pool_k);
            b = plain_pool(b, l->pool_k);
        }
        a = plain_conv(a, l);
        b = plain_conv(b, l);
        if (l->tap >= 0)
            total += plain_distance(&a, &b, l->lin);
    }
    mem_free(a.v);
    mem_free(b.v);
    return total;
}

/* ---- tests ---- */

enum { W_MOST = 75, H_MOST = 40 };

static void picture_fill(float *rgb, float *same, uint8_t *target, uint8_t *mask, size_t n)
{
    for (size_t i = 0; i < 3 * n; i++) {
        rgb[i] = (float)(1.4 * rng_unit(8, 1, i) - 0.2); /* beyond 0..1 as well */
        target[i] = (uint8_t)(rng_u64(8, 2, i) % 256);
        same[i] = (float)target[i] / 255.0f;
        mask[i / 3] = rng_u64(8, 3, i / 3) % 4 != 0;
    }
}

static void check_net(bool vgg, uint32_t vector_width)
{
    static const int sizes[][2] = {{75, 40}, {33, 64}, {48, 31}};
    static float rgb[3 * W_MOST * H_MOST], same[3 * W_MOST * H_MOST];
    static uint8_t target[3 * W_MOST * H_MOST], mask[W_MOST * H_MOST];
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct toy t = toy_make(vgg, false);
    struct buf file = {0};
    struct err e = {0};
    struct dev *d = dev_get();
    uint32_t own = d->vector_width;
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "toy.safetensors", &e), e);
    toy_write(&t, NULL, &file);
    kit_ok(file_write(path, file.data, file.size, &e), e);
    picture_fill(rgb, same, target, mask, W_MOST * H_MOST);
    for (int unit = 0; unit < 2; unit++) {
        struct lpips *l;
        d->vector_width = vector_width ? vector_width : own;
        kit_ok(lpips_open(d, path, unit ? LPIPS_UNIT : LPIPS_SIGNED, &l, &e), e);
        assert_string_equal(lpips_key(l), vgg    ? unit ? "lpips_vgg_unit" : "lpips_vgg"
                                          : unit ? "lpips_alex_unit"
                                                 : "lpips_alex");
        for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++)
            for (int masked = 0; masked < 2; masked++) {
                uint32_t w = (uint32_t)sizes[i][0], h = (uint32_t)sizes[i][1];
                const uint8_t *m = masked ? mask : NULL;
                double got, again, zero;
                kit_ok(lpips_run(l, rgb, target, m, w, h, &got, &e), e);
                kit_ok(lpips_run(l, same, target, m, w, h, &zero, &e), e);
                kit_ok(lpips_run(l, rgb, target, m, w, h, &again, &e), e);
                double want = plain_lpips(&t, rgb, target, m, (int)w, (int)h, unit);
                assert_true(want > 0.01);
                kit_near_d("LPIPS", &got, &want, 1, 0, TOLERANCE);
                assert_true(got == again && zero < 1e-9);
            }
        double got;
        kit_fails(lpips_run(l, rgb, target, NULL, 12, 12, &got, &e), ERR_ARG, e, "too small");
        lpips_close(&l);
        d->vector_width = own;
    }
    buf_free(&file);
    toy_free(&t);
    kit_rmdir(dir);
}

static void test_vgg(void **state)
{
    check_net(true, 0);
}

static void test_alex(void **state)
{
    check_net(false, 0);
}

static void test_narrow_kernels(void **state)
{
    check_net(true, 1);
    check_net(false, 1);
}

/* Seeded weights of the real networks' sizes: 14.7 and 2.5 million numbers. */
static void check_full(bool vgg, uint32_t w, uint32_t h, size_t n_weights)
{
    static float rgb[3 * W_MOST * H_MOST], same[3 * W_MOST * H_MOST];
    static uint8_t target[3 * W_MOST * H_MOST], mask[W_MOST * H_MOST];
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct toy t = toy_make(vgg, true);
    struct buf file = {0};
    struct err e = {0};
    struct lpips *l;
    double got, want;
    size_t n = 0;
    for (size_t i = 0, cin = 3; i < t.n; cin = (size_t)t.layer[i++].cout)
        n += (size_t)t.layer[i].cout * cin * (size_t)(t.layer[i].k * t.layer[i].k);
    assert_int_equal(n, n_weights);
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "full.safetensors", &e), e);
    toy_write(&t, NULL, &file);
    kit_ok(file_write(path, file.data, file.size, &e), e);
    picture_fill(rgb, same, target, mask, W_MOST * H_MOST);
    kit_ok(lpips_open(dev_get(), path, LPIPS_SIGNED, &l, &e), e);
    kit_ok(lpips_run(l, rgb, target, NULL, w, h, &got, &e), e);
    want = plain_lpips(&t, rgb, target, NULL, (int)w, (int)h, false);
    assert_true(want > 0.01);
    kit_near_d("LPIPS at full size", &got, &want, 1, 0, TOLERANCE);
    lpips_close(&l);
    buf_free(&file);
    toy_free(&t);
    kit_rmdir(dir);
}

static void test_full_size_vgg(void **state)
{
    check_full(true, 21, 18, 14710464); /* convolutions of VGG16 without biases */
}

static void test_full_size_alex(void **state)
{
    check_full(false, 45, 37, 2468544);
}

/* What is missing or of another shape is named. */
static void test_incomplete(void **state)
{
    static const char *const missing[] = {"net.slice1.0.weight", "net.slice3.12.weight",
                                          "lin4.model.1.weight"};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    struct toy t = toy_make(true, false);
    struct err e = {0};
    struct lpips *l;
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "toy.safetensors", &e), e);
    for (size_t i = 0; i < 3; i++) {
        struct buf file = {0};
        toy_write(&t, missing[i], &file);
        kit_ok(file_write(path, file.data, file.size, &e), e);
        kit_fails(lpips_open(dev_get(), path, LPIPS_SIGNED, &l, &e), ERR_FORMAT, e, missing[i]);
        assert_null(l);
        buf_free(&file);
    }
    t.layer[5].k = 2; /* the file says so, its numbers do not matter */
    struct buf file = {0};
    toy_write(&t, NULL, &file);
    kit_ok(file_write(path, file.data, file.size, &e), e);
    kit_fails(lpips_open(dev_get(), path, LPIPS_SIGNED, &l, &e), ERR_FORMAT, e, "expected shape");
    buf_free(&file);
    toy_free(&t);
    kit_rmdir(dir);
}

static void decode_fails(const char *head, size_t n_data, const char *part)
{
    struct buf b = {0};
    struct tensors t;
    struct err e = {0};
    buf_u64(&b, strlen(head));
    buf_add(&b, head, strlen(head));
    (void)buf_grow(&b, n_data);
    kit_fails(tensors_decode(b.data, b.size, &t, &e), ERR_FORMAT, e, part);
    assert_true(!t.list && !t.block && t.n == 0);
    buf_free(&b);
}

static enum err_code decode_free(const void *user, const void *bytes, size_t n,
                                 const struct codec_limits *lim, struct err *e)
{
    struct tensors t;
    (void)user, (void)lim;
    enum err_code rc = tensors_decode(bytes, n, &t, e);
    if (rc)
        assert_true(!t.list && !t.block && t.n == 0);
    tensors_free(&t);
    return rc;
}

static const struct torture torture = {.name = "safetensors", .decode = decode_free};

static void test_hostile_files(void **state)
{
    struct tensors t;
    struct err e = {0};
    struct toy toy = toy_make(false, false);
    struct buf file = {0};
    decode_fails("[]", 0, "not an object");
    decode_fails("{\"a\":3}", 8, "no dtype");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[0,12]}}", 8, "outside");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[2],\"data_offsets\":[8,0]}}", 8, "outside");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[1],\"data_offsets\":[2,6]}}", 8, "outside");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[3],\"data_offsets\":[0,8]}}", 8,
                 "8 bytes for");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[-1],\"data_offsets\":[0,8]}}", 8, "shape");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[2147483647,2147483647,2147483647],"
                 "\"data_offsets\":[0,8]}}",
                 8, "shape");
    decode_fails("{\"a\":{\"dtype\":\"F32\",\"shape\":[2.5],\"data_offsets\":[0,8]}}", 8, "shape");
    static const uint8_t huge[16] = {255, 255, 255, 255, 255, 255, 255, 127, '{', '}'};
    kit_fails(tensors_decode(huge, sizeof huge, &t, &e), ERR_FORMAT, e, "cut off");
    kit_fails(tensors_decode(huge, 5, &t, &e), ERR_FORMAT, e, "cut off");
    toy_write(&toy, NULL, &file);
    torture_cuts(&torture, &file, 97);
    torture_flips(&torture, &file, 1000, 9, 400); /* in the header */
    kit_ok(tensors_decode(file.data, file.size, &t, &e), e);
    const struct tensor *w = tensors_find(&t, "net.slice2.3.weight");
    assert_true(w && w->ndim == 4 && w->shape[2] == 5 && w->data[7] == toy.layer[1].w[7]);
    assert_null(tensors_find(&t, "__metadata__"));
    tensors_free(&t);
    kit_out_of_memory((tensors_free(&t), tensors_decode(file.data, file.size, &t, &e)), 1, e);
    tensors_free(&t);
    buf_free(&file);
    toy_free(&toy);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_hostile_files),
        cmocka_unit_test(test_incomplete),
        cmocka_unit_test(test_vgg),
        cmocka_unit_test(test_alex),
        cmocka_unit_test(test_full_size_vgg),
        cmocka_unit_test(test_full_size_alex),
        cmocka_unit_test(test_narrow_kernels),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    dev_close(dev_get());
    return failed;
}
