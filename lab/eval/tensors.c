/* Reading .safetensors: see tensors.h. The header is foreign: every number in it is checked against
 * the bytes at hand before it is used.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "lab/eval/tensors.h"

#include <string.h>

#include <jansson.h>

enum { TENSORS_HEAD_MAX = 1 << 20, TENSORS_LENGTH_BYTES = 8 };
#define TENSORS_FILE_MAX ((size_t)2 << 30)

/* The places [begin, end) of a tensor in the data, in bytes. */
static enum err_code tensors_places(const char *name, const json_t *o, size_t n_data, size_t *begin,
                                    size_t *end, struct err *e)
{
    const json_t *places = json_object_get(o, "data_offsets");
    json_int_t b = json_integer_value(json_array_get(places, 0));
    json_int_t z = json_integer_value(json_array_get(places, 1));
    if (json_array_size(places) != 2 || !json_is_integer(json_array_get(places, 0)) ||
        !json_is_integer(json_array_get(places, 1)) || b < 0 || z < b ||
        (unsigned long long)z > n_data || b % (json_int_t)sizeof(float))
        return err_set(e, ERR_FORMAT, "safetensors: %s: data_offsets lie outside the file", name);
    *begin = (size_t)b;
    *end = (size_t)z;
    return ERR_OK;
}

static enum err_code tensors_shape(const char *name, const json_t *o, struct tensor *t,
                                   struct err *e)
{
    const json_t *shape = json_object_get(o, "shape");
    t->ndim = json_array_size(shape);
    t->count = 1;
    for (size_t i = 0; i < t->ndim; i++) {
        const json_t *v = json_array_get(shape, i);
        json_int_t k = json_integer_value(v);
        if (!json_is_integer(v) || k < 0 || k > INT32_MAX ||
            (k && t->count > SIZE_MAX / sizeof(float) / (size_t)k))
            return err_set(e, ERR_FORMAT, "safetensors: %s: impossible shape", name);
        t->shape[i] = (size_t)k;
        t->count *= (size_t)k;
    }
    return ERR_OK;
}

static enum err_code tensors_add(struct tensors *out, const char *name, const json_t *o,
                                 size_t n_data, struct err *e)
{
    struct tensor t = {0};
    size_t begin = 0, end = 0;
    const char *dtype = json_string_value(json_object_get(o, "dtype"));
    if (!dtype || !json_is_array(json_object_get(o, "shape")))
        return err_set(e, ERR_FORMAT, "safetensors: %s: no dtype or no shape", name);
    if (strcmp(dtype, "F32") || json_array_size(json_object_get(o, "shape")) > TENSORS_DIMS_MAX)
        return ERR_OK;
    enum err_code rc = tensors_shape(name, o, &t, e);
    if (!rc)
        rc = tensors_places(name, o, n_data, &begin, &end, e);
    if (!rc && end - begin != t.count * sizeof(float))
        rc = err_set(e, ERR_FORMAT, "safetensors: %s: %zu bytes for %zu numbers", name, end - begin,
                     t.count);
    t.data = out->block + begin / sizeof(float);
    t.name = arena_text(&out->arena, name);
    if (!rc && !t.name)
        rc = err_set(e, ERR_MEM, "safetensors: out of memory");
    if (!rc)
        out->list[out->n++] = t;
    return rc;
}

static enum err_code tensors_fill(struct tensors *out, json_t *head, const uint8_t *data,
                                  size_t n_data, struct err *e)
{
    const char *name;
    json_t *o;
    enum err_code rc = ERR_OK;
    out->list = mem_array(json_object_size(head), sizeof *out->list);
    out->block = mem_array(n_data / sizeof(float) + 1, sizeof(float));
    if (!out->list || !out->block)
        return err_set(e, ERR_MEM, "safetensors: %zu bytes: out of memory", n_data);
    memcpy(out->block, data, n_data);
    json_object_foreach(head, name, o)
    {
        if (!rc && strcmp(name, "__metadata__"))
            rc = tensors_add(out, name, o, n_data, e);
    }
    return rc;
}

enum err_code tensors_decode(const void *bytes, size_t n, struct tensors *out, struct err *e)
{
    struct cursor c = cursor_over(bytes, n);
    json_t *head = NULL;
    *out = (struct tensors){0};
    uint64_t n_head = cursor_u64(&c);
    if (c.bad || n_head > TENSORS_HEAD_MAX || n_head > cursor_left(&c))
        return err_set(e, ERR_FORMAT,
                       "safetensors: not a .safetensors file, or cut off in its header");
    const char *text = (const char *)cursor_take(&c, (size_t)n_head);
    enum err_code rc = jsonc_parse(text, (size_t)n_head, "safetensors header", &head, e);
    if (!rc && !json_is_object(head))
        rc = err_set(e, ERR_FORMAT, "safetensors: the header is not an object");
    if (!rc)
        rc = tensors_fill(out, head, c.p, cursor_left(&c), e);
    json_decref(head);
    if (rc)
        tensors_free(out);
    return rc;
}

enum err_code tensors_read(const char *path, struct tensors *out, struct err *e)
{
    struct buf b = {0};
    *out = (struct tensors){0};
    enum err_code rc = file_read(path, TENSORS_FILE_MAX, &b, e);
    if (!rc && (rc = tensors_decode(b.data, b.size, out, e)) != ERR_OK)
        err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}

void tensors_free(struct tensors *t)
{
    mem_free(t->list);
    mem_free(t->block);
    arena_free(&t->arena);
    *t = (struct tensors){0};
}

const struct tensor *tensors_find(const struct tensors *t, const char *name)
{
    for (size_t i = 0; i < t->n; i++)
        if (!strcmp(t->list[i].name, name))
            return &t->list[i];
    return NULL;
}
