/* Markers of Metashape: see gcp_metashape.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_metashape.h"

#include <stdio.h>
#include <string.h>

#include "codec/container/xml.h"
#include "core/base.h"
#include "scene/control/wkt.h"

enum { XML_BYTES_MAX = 256 << 20, XML_DEPTH = 32 };

struct named { /* a camera or a marker */
    long long id;
    char label[GCP_IMAGE_MAX];
    size_t gcp; /* of a marker: in the list; SIZE_MAX: it has no coordinates */
};
struct named_list {
    struct named *list;
    size_t n, cap;
};
struct metashape {
    struct xml x;
    struct gcp_list *l;
    char in[XML_DEPTH][XML_NAME]; /* the open elements */
    size_t depth, chunks, frames;
    struct named_list cameras, markers;
    struct named *marker; /* the open one; NULL: none, or one that is not known */
};

static enum err_code metashape_add(struct named_list *l, const struct named *one, struct err *e)
{
    struct named *p = mem_room(l->list, l->n, &l->cap, 64, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for markers");
    l->list = p;
    l->list[l->n++] = *one;
    return ERR_OK;
}

/* Ids are mostly the places in the list. */
static struct named *metashape_find(const struct named_list *l, long long id)
{
    if (id >= 0 && (size_t)id < l->n && l->list[id].id == id)
        return &l->list[id];
    for (size_t i = 0; i < l->n; i++)
        if (l->list[i].id == id)
            return &l->list[i];
    return NULL;
}

static bool metashape_within(const struct metashape *m, const char *name)
{
    for (size_t k = 0; k < m->depth; k++)
        if (!strcmp(m->in[k], name))
            return true;
    return false;
}

static bool metashape_directly(const struct metashape *m, const char *name)
{
    return m->depth && !strcmp(m->in[m->depth - 1], name);
}

/* A camera or a marker of the chunk. */
static enum err_code metashape_name(struct metashape *m, const struct xml_tag *t,
                                    struct named_list *to, size_t longest, struct err *e)
{
    struct named one = {.gcp = SIZE_MAX};
    if (!xml_id(t, "id", &one.id) || !xml_attr(t, "label", one.label, sizeof one.label))
        return xml_bad(&m->x, "a camera or marker has no id, or no label of at most 247 bytes", e);
    if (strlen(one.label) >= longest)
        return xml_bad(&m->x, "the label of a marker has over 63 bytes", e);
    return metashape_add(to, &one, e);
}

/* Coordinates and accuracies of the open marker. */
static enum err_code metashape_place(struct metashape *m, const struct xml_tag *t, struct err *e)
{
    struct gcp g = {.line = m->x.line, .check = xml_off(t, "enabled")};
    double sigma;
    if (!m->marker || !xml_number(t, "x", &g.file[0]) || !xml_number(t, "y", &g.file[1]) ||
        !xml_number(t, "z", &g.file[2]))
        return ERR_OK;
    if (xml_number(t, "sxyz", &sigma) && sigma > 0)
        g.sigma_m[0] = g.sigma_m[1] = sigma;
    if ((xml_number(t, "sxy", &sigma) || xml_number(t, "sx", &sigma)) && sigma > 0)
        g.sigma_m[0] = sigma;
    if (xml_number(t, "sz", &sigma) && sigma > 0)
        g.sigma_m[1] = sigma;
    snprintf(g.name, sizeof g.name, "%.*s", GCP_NAME_MAX - 1, m->marker->label);
    const size_t before = m->l->n;
    enum err_code rc = gcp_add_point(m->x.path, m->l, &g, e);
    if (rc)
        return rc;
    m->marker->gcp = m->l->n - 1;
    for (size_t i = 0; i < before; i++) /* a second marker of the name at the same place */
        if (!strcmp(m->l->gcps[i].name, g.name))
            m->marker->gcp = i;
    return ERR_OK;
}

/* The place of the open marker in a photograph. Those that nobody has set or confirmed are not
 * pinned. */
static enum err_code metashape_mark(struct metashape *m, const struct xml_tag *t, struct err *e)
{
    struct gcp_mark mark = {.line = m->x.line};
    long long id;
    if (xml_off(t, "pinned") || !m->marker || m->marker->gcp == SIZE_MAX)
        return ERR_OK;
    if (!xml_id(t, "camera_id", &id) || !xml_number(t, "x", &mark.x_px) ||
        !xml_number(t, "y", &mark.y_px))
        return xml_bad(&m->x, "a place in a photograph has no camera_id, x and y", e);
    const struct named *camera = metashape_find(&m->cameras, id);
    if (!camera)
        return err_set(e, ERR_FORMAT, "%s: line %zu: there is no camera of id %lld", m->x.path,
                       m->x.line, id);
    mark.gcp = m->marker->gcp;
    memcpy(mark.image, camera->label, sizeof mark.image);
    return gcp_add_mark(m->l, &mark, e);
}

static enum err_code metashape_open(struct metashape *m, const struct xml_tag *t, struct err *e)
{
    long long id;
    m->chunks += !strcmp(t->name, "chunk");
    m->frames += !strcmp(t->name, "frame");
    if (m->chunks > 1)
        return xml_bad(&m->x, "a second chunk: export the markers of one", e);
    if (metashape_within(m, "frame")) { /* of several, at different times, the first */
        if (m->frames > 1)
            return ERR_OK;
        if (!strcmp(t->name, "location") && metashape_directly(m, "marker"))
            return metashape_mark(m, t, e);
        if (!strcmp(t->name, "marker"))
            m->marker = xml_id(t, "marker_id", &id) ? metashape_find(&m->markers, id) : NULL;
        return ERR_OK;
    }
    if (!strcmp(t->name, "camera") && metashape_within(m, "cameras"))
        return metashape_name(m, t, &m->cameras, GCP_IMAGE_MAX, e);
    if (!strcmp(t->name, "reference") && metashape_directly(m, "marker"))
        return metashape_place(m, t, e);
    if (strcmp(t->name, "marker") || !metashape_within(m, "markers"))
        return ERR_OK;
    enum err_code rc = metashape_name(m, t, &m->markers, GCP_NAME_MAX, e);
    m->marker = rc ? NULL : &m->markers.list[m->markers.n - 1];
    return rc;
}

/* The text of the chunk's coordinate system. */
static void metashape_system(struct metashape *m)
{
    char text[4096];
    size_t used = 0;
    const char *p = m->x.p + strspn(m->x.p, " \t\r\n"), *end = p + strcspn(p, "<");
    while (p < end && used + 8 < sizeof text) {
        size_t n;
        char c[8];
        p = xml_character(p, end, c, &n);
        memcpy(text + used, c, n);
        used += n;
    }
    text[used] = '\0';
    int epsg, heights;
    if (!wkt_epsg(text, &epsg, &heights))
        return;
    m->l->epsg = epsg;
    m->l->heights_epsg = heights;
}

static enum err_code metashape_tag(struct metashape *m, const struct xml_tag *t, struct err *e)
{
    enum err_code rc = t->opens ? metashape_open(m, t, e) : ERR_OK;
    if (rc || (t->opens && t->closes))
        return rc;
    if (t->opens) {
        if (m->depth == XML_DEPTH)
            return xml_bad(&m->x, "elements lie too deep in each other", e);
        if (!strcmp(t->name, "reference") && metashape_directly(m, "chunk"))
            metashape_system(m);
        memcpy(m->in[m->depth++], t->name, XML_NAME);
        return ERR_OK;
    }
    if (!m->depth || strcmp(m->in[m->depth - 1], t->name))
        return xml_bad(&m->x, "an element ends that is not open", e);
    m->depth--;
    return ERR_OK;
}

static void metashape_warn(const struct metashape *m)
{
    size_t without = 0;
    const char *first = "";
    for (size_t i = m->markers.n; i-- > 0;)
        if (m->markers.list[i].gcp == SIZE_MAX) {
            without++;
            first = m->markers.list[i].label;
        }
    if (without)
        log_warn("gcp", "%s: markers without coordinates are left out: %zu, the first is '%s'",
                 m->x.path, without, first);
}

bool gcp_metashape_is(const char *path)
{
    char head[64] = "";
    FILE *f = fopen(path, "rb");
    const size_t n = f ? fread(head, 1, sizeof head - 1, f) : 0;
    if (f)
        fclose(f);
    head[n] = '\0';
    const char *p = head + (!strncmp(head, "\xef\xbb\xbf", 3) ? 3 : 0);
    return p[strspn(p, " \t\r\n")] == '<';
}

enum err_code gcp_metashape_read(const char *path, struct gcp_list *l, struct err *e)
{
    struct buf b = {0};
    struct metashape m = {.l = l, .x = {.path = path, .line = 1}};
    struct xml_tag t;
    bool more = true;
    enum err_code rc = file_read(path, XML_BYTES_MAX, &b, e);
    buf_u8(&b, 0);
    if (!rc)
        rc = buf_check(&b, e);
    m.x.p = (const char *)b.data;
    while (!rc && !(rc = xml_next(&m.x, &t, &more, e)) && more)
        rc = metashape_tag(&m, &t, e);
    if (!rc && m.depth)
        rc = xml_bad(&m.x, "the file ends within an element", e);
    if (!rc && !m.markers.n)
        rc =
            err_set(e, ERR_DATA, "%s: no markers; expected is what Metashape exports as XML", path);
    if (!rc)
        metashape_warn(&m);
    mem_free(m.cameras.list);
    mem_free(m.markers.list);
    buf_free(&b);
    return rc;
}
