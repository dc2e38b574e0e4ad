/* Header of a .ply: lines of text up to end_header, then the elements' rows one after the other.
 *
 * Everything a hostile header can say is bounded here: line and property counts, element counts
 * against the bytes that follow. Comments that matter: "citysplat origin lon lat h", "citysplat
 * heights sea", "axes ENU|glTF", and the two ways in which trainers say that they used
 * anti-aliasing. Source: G. Turk, The PLY Polygon File Format, 1994.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/ply_head.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LINE_MAX_BYTES = 1024, LINES_MAX = 65536, ELEMENTS_MAX = 16, PROPERTIES_MAX = 512 };

static const struct {
    const char *name, *other;
    uint8_t bytes;
} types[] = {
    [PLY_I8] = {"char", "int8", 1},      [PLY_U8] = {"uchar", "uint8", 1},
    [PLY_I16] = {"short", "int16", 2},   [PLY_U16] = {"ushort", "uint16", 2},
    [PLY_I32] = {"int", "int32", 4},     [PLY_U32] = {"uint", "uint32", 4},
    [PLY_F32] = {"float", "float32", 4}, [PLY_F64] = {"double", "float64", 8},
};

static bool head_type_find(const char *name, enum ply_type *out)
{
    for (size_t i = 0; i < sizeof types / sizeof *types; i++)
        if (!strcmp(name, types[i].name) || !strcmp(name, types[i].other)) {
            *out = (enum ply_type)i;
            return true;
        }
    return false;
}

/* The next line into `line` without its end, of a comment as much as fits; false at the end of the
 * bytes or when too long. */
static bool head_next_line(struct cursor *c, char line[LINE_MAX_BYTES])
{
    size_t n = 0;
    while (cursor_left(c)) {
        char ch = (char)cursor_u8(c);
        if (ch == '\n') {
            if (n && line[n - 1] == '\r')
                n--;
            line[n] = 0;
            return true;
        }
        if (n + 1 < LINE_MAX_BYTES)
            line[n++] = ch;
        else if (strncmp(line, "comment", 7) != 0 && strncmp(line, "obj_info", 8) != 0)
            return false;
    }
    return false;
}

static void head_comment_read(struct ply_head *h, const char *text)
{
    struct geo_origin o;
    int flag;
    if (sscanf(text, "citysplat origin %lf %lf %lf", &o.lon_deg, &o.lat_deg, &o.h_m) == 3 &&
        isfinite(o.h_m) && fabs(o.lat_deg) <= 90 && fabs(o.lon_deg) <= 360) {
        h->info.has_origin = true;
        h->info.origin = o;
    }
    static const char heights[] = "citysplat heights ";
    const char *count_from = text + sizeof heights - 1;
    if (!strncmp(text, heights, sizeof heights - 1) && strlen(count_from) < HEIGHTS_MAX &&
        heights_valid(count_from))
        snprintf(h->info.heights, sizeof h->info.heights, "%s", count_from);
    if (!strcmp(text, "axes ENU"))
        h->info.axes = PLY_AXES_ENU;
    if (!strcmp(text, "axes glTF"))
        h->info.axes = PLY_AXES_GLTF;
    if (!strcmp(text, "SplatRenderMode: mip") ||
        (sscanf(text, "antialiased %d", &flag) == 1 && flag))
        h->antialiased = true;
}

static enum err_code head_element_read(struct ply_head *h, const char *name, const char *count,
                                       struct err *e)
{
    char *end;
    unsigned long long n = strtoull(count, &end, 10);
    if (h->n_elements == ELEMENTS_MAX)
        return err_set(e, ERR_LIMIT, "more than %d elements", ELEMENTS_MAX);
    if (end == count || *end || *count == '-' || n > SIZE_MAX / 8)
        return err_set(e, ERR_FORMAT, "element %.40s: count '%.40s' is not a number", name, count);
    if (!h->elements) {
        h->elements = arena_get(&h->arena, ELEMENTS_MAX, sizeof *h->elements);
        if (!h->elements)
            return err_set(e, ERR_MEM, "out of memory");
    }
    struct ply_element *el = &h->elements[h->n_elements];
    el->name = arena_text(&h->arena, name);
    el->props = arena_get(&h->arena, PROPERTIES_MAX, sizeof *el->props);
    if (!el->name || !el->props)
        return err_set(e, ERR_MEM, "out of memory");
    el->count = (size_t)n;
    h->n_elements++;
    return ERR_OK;
}

static enum err_code head_property_read(struct ply_head *h, const char *type, const char *name,
                                        struct err *e)
{
    if (!h->n_elements)
        return err_set(e, ERR_FORMAT, "a property before the first element");
    struct ply_element *el = &h->elements[h->n_elements - 1];
    struct ply_property *p = &el->props[el->n_props];
    if (el->n_props == PROPERTIES_MAX)
        return err_set(e, ERR_LIMIT, "element %.40s: more than %d properties", el->name,
                       PROPERTIES_MAX);
    if (!strcmp(type, "list"))
        p->type = PLY_LIST;
    else if (!head_type_find(type, &p->type))
        return err_set(e, ERR_FORMAT, "property type '%.40s' is unknown", type);
    if (p->type != PLY_LIST && ply_head_property(el, name))
        return err_set(e, ERR_FORMAT, "property %.40s stands twice", name);
    p->name = arena_text(&h->arena, p->type == PLY_LIST ? "" : name);
    if (!p->name)
        return err_set(e, ERR_MEM, "out of memory");
    for (size_t i = 0; i < el->n_props; i++)
        if (el->props[i].type != PLY_LIST)
            p->offset += h->format == PLY_ASCII ? 1 : types[el->props[i].type].bytes;
    el->n_props++;
    return ERR_OK;
}

static enum err_code head_line_read(struct ply_head *h, char *line, bool *format_seen, bool *done,
                                    struct err *e)
{
    char word[3][LINE_MAX_BYTES] = {{0}};
    int n = sscanf(line, "%1023s %1023s %1023s", word[0], word[1], word[2]);
    if (n < 1 || !strcmp(word[0], "obj_info"))
        return ERR_OK;
    if (!strcmp(word[0], "comment")) {
        if (n > 1)
            head_comment_read(h, strstr(line, word[1]));
        return ERR_OK;
    }
    if (!strcmp(word[0], "end_header")) {
        *done = true;
        return ERR_OK;
    }
    if (!strcmp(word[0], "format") && n == 3 && !h->n_elements) {
        static const char *const formats[] = {"ascii", "binary_little_endian", "binary_big_endian"};
        for (int f = 0; f < 3; f++)
            if (!strcmp(word[1], formats[f])) {
                h->format = (enum ply_format)f;
                *format_seen = true;
                return ERR_OK;
            }
    }
    if (!strcmp(word[0], "element") && n == 3)
        return head_element_read(h, word[1], word[2], e);
    if (!strcmp(word[0], "property") && n == 3)
        return head_property_read(h, word[1], word[2], e);
    return err_set(e, ERR_FORMAT, "'%.40s' is not understood", line);
}

/* Where each element's rows are, as far as that can be told without reading lists. */
static enum err_code head_place_rows(struct ply_head *h, struct err *e)
{
    bool known = h->format != PLY_ASCII;
    size_t at = 0, left = h->n_body;
    for (size_t i = 0; i < h->n_elements; i++) {
        struct ply_element *el = &h->elements[i];
        for (size_t k = 0; k < el->n_props; k++) {
            if (el->props[k].type == PLY_LIST)
                known = known && !el->count; /* an element without rows takes no room */
            else
                el->row_bytes += types[el->props[k].type].bytes;
        }
        if (!known)
            continue;
        if (el->row_bytes && el->count > left / el->row_bytes)
            return err_set(e, ERR_FORMAT,
                           "ply: element %.40s: %zu rows of %zu bytes announced, %zu bytes are "
                           "there: truncated",
                           el->name, el->count, el->row_bytes, left);
        el->rows = h->body ? h->body + at : NULL;
        el->rows_at = h->body_at + at;
        at += el->count * el->row_bytes;
        left -= el->count * el->row_bytes;
    }
    return ERR_OK;
}

enum err_code ply_head_read(const void *bytes, size_t n, struct ply_head *out, struct err *e)
{
    return ply_head_read_of(bytes, n, n, out, e);
}

enum err_code ply_head_read_of(const void *bytes, size_t n, size_t n_file, struct ply_head *out,
                               struct err *e)
{
    struct cursor c = cursor_over(bytes, n);
    char line[LINE_MAX_BYTES];
    bool format_seen = false, done = false;
    *out = (struct ply_head){0};
    if (!head_next_line(&c, line) || strcmp(line, "ply"))
        return err_set(e, ERR_FORMAT, "ply: not a .ply file");
    for (size_t i = 2; !done; i++) {
        if (i > LINES_MAX || !head_next_line(&c, line))
            return err_set(e, ERR_FORMAT, "ply: line %zu: truncated, too long, or no end_header",
                           i);
        enum err_code rc = head_line_read(out, line, &format_seen, &done, e);
        if (rc) {
            err_add(e, "ply: line %zu", i);
            return rc;
        }
    }
    if (!format_seen)
        return err_set(e, ERR_FORMAT, "ply: no format line in the header");
    out->body_at = n - cursor_left(&c);
    out->body = n == n_file ? c.p : NULL;
    out->n_body = n_file - out->body_at;
    return head_place_rows(out, e);
}

void ply_head_free(struct ply_head *h)
{
    arena_free(&h->arena);
    *h = (struct ply_head){0};
}

const struct ply_element *ply_head_element(const struct ply_head *h, const char *name)
{
    for (size_t i = 0; i < h->n_elements; i++)
        if (!strcmp(h->elements[i].name, name))
            return &h->elements[i];
    return NULL;
}

const struct ply_property *ply_head_property(const struct ply_element *el, const char *name)
{
    for (size_t i = 0; i < el->n_props; i++)
        if (!strcmp(el->props[i].name, name))
            return &el->props[i];
    return NULL;
}

double ply_head_value(const struct ply_head *h, const struct ply_property *p, const uint8_t *row)
{
    const size_t bytes = types[p->type].bytes;
    const uint8_t *at = row + p->offset;
    uint64_t u = 0;
    if (p->type == PLY_F32 && h->format == PLY_LITTLE) { /* nearly always */
        float v;
        memcpy(&v, at, 4);
        return (double)v;
    }
    for (size_t i = 0; i < bytes; i++)
        u |= (uint64_t)at[h->format == PLY_BIG ? bytes - 1 - i : i] << 8 * i;
    uint32_t u32 = (uint32_t)u;
    float f;
    double d;
    switch (p->type) {
    case PLY_I8:
        return (int8_t)u;
    case PLY_I16:
        return (int16_t)u;
    case PLY_I32:
        return (int32_t)u32;
    case PLY_F32:
        memcpy(&f, &u32, 4);
        return (double)f;
    case PLY_F64:
        memcpy(&d, &u, 8);
        return d;
    default:
        return (double)u;
    }
}

void ply_head_comments(const struct ply_info *info, bool antialiased, struct buf *out)
{
    buf_printf(out, "ply\nformat binary_little_endian 1.0\n");
    if (info && info->has_origin)
        buf_printf(out, "comment citysplat origin %.17g %.17g %.17g\n", info->origin.lon_deg,
                   info->origin.lat_deg, info->origin.h_m);
    if (info && info->has_origin && info->heights[0])
        buf_printf(out, "comment citysplat heights %s\n", info->heights);
    if (!info || info->axes != PLY_AXES_UNKNOWN)
        buf_printf(out, "comment axes %s\n", info && info->axes == PLY_AXES_GLTF ? "glTF" : "ENU");
    if (antialiased)
        buf_printf(out, "comment antialiased 1\n");
}
