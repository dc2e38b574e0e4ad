/* Arrays of float32 in NumPy's .npy, format version 1.0, C order: the way depth and normal maps
 * come in and intermediate results go out to other tools. Other types and orders are refused by
 * name.
 *
 * Source: numpy.lib.format. SPDX-License-Identifier: Apache-2.0
 */
#include "codec/container/npy.h"
#include "core/base.h"

#include <stdlib.h>
#include <string.h>

enum { MAGIC_BYTES = 6, ALIGN = 64 };

enum err_code npy_write(const char *path, const float *data, size_t ndim, const size_t *shape,
                        struct err *e)
{
    struct buf head = {0}, b = {0};
    size_t count = 1;
    buf_printf(&head, "{'descr': '<f4', 'fortran_order': False, 'shape': (");
    for (size_t i = 0; i < ndim; i++) {
        buf_printf(&head, "%zu%s", shape[i], ndim == 1 ? "," : i + 1 < ndim ? ", " : "");
        count *= shape[i];
    }
    buf_printf(&head, "), }");
    while ((MAGIC_BYTES + 4 + head.size + 1) % ALIGN && !head.failed)
        buf_u8(&head, ' ');
    buf_u8(&head, '\n');
    buf_add(&b, "\x93NUMPY\x01\x00", MAGIC_BYTES + 2);
    buf_u16(&b, (unsigned)head.size);
    buf_add(&b, head.data, head.size);
    buf_add(&b, data, count * sizeof *data);
    b.failed = b.failed || head.failed;
    enum err_code rc = buf_check(&b, e);
    if (!rc)
        rc = file_write(path, b.data, b.size, e);
    buf_free(&head);
    buf_free(&b);
    return rc;
}

/* The value of a key of the header's dictionary, or NULL. */
static const char *npy_dict_find(const char *head, const char *key)
{
    const char *p = strstr(head, key);
    if (!p || !(p = strchr(p + strlen(key), ':')))
        return NULL;
    p++;
    while (*p == ' ')
        p++;
    return p;
}

static enum err_code npy_head_parse(const char *head, size_t ndim, size_t *shape, size_t *count,
                                    struct err *e)
{
    const char *descr = npy_dict_find(head, "'descr'"),
               *order = npy_dict_find(head, "'fortran_order'");
    const char *p = npy_dict_find(head, "'shape'");
    if (!descr || !order || !p || *p != '(')
        return err_set(e, ERR_FORMAT,
                       "npy: header is not a dictionary of descr, fortran_order, shape");
    if (strncmp(descr, "'<f4'", 5) || strncmp(order, "False", 5))
        return err_set(e, ERR_FORMAT, "npy: only '<f4' in C order is read, this is %.12s", descr);
    *count = 1;
    p++;
    for (size_t i = 0; i < ndim; i++) {
        char *end;
        unsigned long long v = strtoull(p, &end, 10);
        if (end == p || *p == '-' || (*end != ',' && *end != ')'))
            return err_set(e, ERR_FORMAT, "npy: shape has fewer than %zu dimensions", ndim);
        if (v && *count > SIZE_MAX / sizeof(float) / v)
            return err_set(e, ERR_LIMIT, "npy: shape overflows");
        shape[i] = (size_t)v;
        *count *= (size_t)v;
        for (p = *end == ',' ? end + 1 : end; *p == ' '; p++)
            ;
    }
    if (*p != ')')
        return err_set(e, ERR_FORMAT, "npy: shape has more than %zu dimensions", ndim);
    return ERR_OK;
}

enum err_code npy_decode(const void *bytes, size_t n, size_t ndim, size_t *shape, float **data,
                         struct err *e)
{
    struct cursor c = cursor_over(bytes, n);
    size_t count = 0;
    *data = NULL;
    const uint8_t *magic = cursor_take(&c, MAGIC_BYTES + 2);
    if (!magic || memcmp(magic, "\x93NUMPY", MAGIC_BYTES) || magic[6] < 1 || magic[6] > 3)
        return err_set(e, ERR_FORMAT, "npy: not a .npy file of version 1 to 3");
    size_t n_head = magic[6] == 1 ? cursor_u16(&c) : cursor_u32(&c);
    const uint8_t *text = c.bad ? NULL : cursor_take(&c, n_head);
    if (!text)
        return err_set(e, ERR_FORMAT, "npy: truncated in its header");
    char *head = mem_array(n_head + 1, 1);
    if (!head)
        return err_set(e, ERR_MEM, "npy: out of memory");
    memcpy(head, text, n_head);
    enum err_code rc = npy_head_parse(head, ndim, shape, &count, e);
    mem_free(head);
    if (rc)
        return rc;
    if (cursor_left(&c) / sizeof **data < count)
        return err_set(e, ERR_FORMAT, "npy: %zu values announced, room for %zu: truncated", count,
                       cursor_left(&c) / sizeof **data);
    if (!(*data = mem_array(count, sizeof **data)))
        return err_set(e, ERR_MEM, "npy: %zu values: out of memory", count);
    if (count)
        memcpy(*data, c.p, count * sizeof **data);
    return ERR_OK;
}

enum err_code npy_read(const char *path, size_t ndim, size_t *shape, float **data, struct err *e)
{
    struct buf b = {0};
    *data = NULL;
    enum err_code rc = file_read(path, 0, &b, e);
    if (!rc && (rc = npy_decode(b.data, b.size, ndim, shape, data, e)) != ERR_OK)
        err_add(e, "%s", path);
    buf_free(&b);
    return rc;
}
