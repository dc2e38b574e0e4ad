/* Markers of Metashape: see gcp_metashape.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp_metashape.h"

#include <expat.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core/base.h"
#include "scene/control/wkt.h"

enum { METASHAPE_BYTES_MAX = 256 << 20, METASHAPE_DEPTH = 32, METASHAPE_NAME = 24 };

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
    XML_Parser parser;
    const char *path;
    enum err_code rc; /* of what was read so far, with e */
    struct err *e;
    struct gcp_list *l;
    char in[METASHAPE_DEPTH][METASHAPE_NAME]; /* the open elements, cut where they are longer */
    size_t depth, chunks, frames;
    struct named_list cameras, markers;
    struct named *marker; /* the open one; NULL: none, or one that is not known */
    char system[4096];    /* text of the chunk's coordinate system */
    size_t n_system;
};

static size_t metashape_line(const struct metashape *m)
{
    return (size_t)XML_GetCurrentLineNumber(m->parser);
}

static enum err_code metashape_bad(const struct metashape *m, const char *why, struct err *e)
{
    return err_set(e, ERR_FORMAT, "%s: line %zu: %s", m->path, metashape_line(m), why);
}

/* ---- attributes: names and values in turn, then NULL ---- */

static const char *metashape_text(const char **att, const char *name)
{
    for (; *att; att += 2)
        if (!strcmp(att[0], name))
            return att[1];
    return NULL;
}

/* Whether it is there and a finite number. */
static bool metashape_number(const char **att, const char *name, double *out)
{
    const char *text = metashape_text(att, name);
    return text && number_list(text, 1, out);
}

static bool metashape_id(const char **att, const char *name, long long *out)
{
    const char *text = metashape_text(att, name);
    char *end;
    if (!text)
        return false;
    *out = strtoll(text, &end, 10);
    return end != text && !*end;
}

static bool metashape_off(const char **att, const char *name)
{
    const char *text = metashape_text(att, name);
    return text && (!strcmp(text, "0") || !strcmp(text, "false"));
}

/* ---- elements ---- */

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
static enum err_code metashape_name(struct metashape *m, const char **att, struct named_list *to,
                                    size_t longest, struct err *e)
{
    struct named one = {.gcp = SIZE_MAX};
    const char *label = metashape_text(att, "label");
    if (!metashape_id(att, "id", &one.id) || !label || strlen(label) >= sizeof one.label)
        return metashape_bad(m, "a camera or marker has no id, or no label of at most 255 bytes",
                             e);
    if (strlen(label) >= longest)
        return metashape_bad(m, "the label of a marker has over 63 bytes", e);
    memcpy(one.label, label, strlen(label) + 1);
    return metashape_add(to, &one, e);
}

/* Coordinates and accuracies of the open marker. */
static enum err_code metashape_place(struct metashape *m, const char **att, struct err *e)
{
    struct gcp g = {.line = metashape_line(m), .check = metashape_off(att, "enabled")};
    double sigma;
    if (!m->marker || !metashape_number(att, "x", &g.file[0]) ||
        !metashape_number(att, "y", &g.file[1]) || !metashape_number(att, "z", &g.file[2]))
        return ERR_OK;
    if (metashape_number(att, "sxyz", &sigma) && sigma > 0)
        g.sigma_m[0] = g.sigma_m[1] = sigma;
    if ((metashape_number(att, "sxy", &sigma) || metashape_number(att, "sx", &sigma)) && sigma > 0)
        g.sigma_m[0] = sigma;
    if (metashape_number(att, "sz", &sigma) && sigma > 0)
        g.sigma_m[1] = sigma;
    snprintf(g.name, sizeof g.name, "%.*s", GCP_NAME_MAX - 1, m->marker->label);
    const size_t before = m->l->n;
    enum err_code rc = gcp_add_point(m->path, m->l, &g, e);
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
static enum err_code metashape_mark(struct metashape *m, const char **att, struct err *e)
{
    struct gcp_mark mark = {.line = metashape_line(m)};
    long long id;
    if (metashape_off(att, "pinned") || !m->marker || m->marker->gcp == SIZE_MAX)
        return ERR_OK;
    if (!metashape_id(att, "camera_id", &id) || !metashape_number(att, "x", &mark.x_px) ||
        !metashape_number(att, "y", &mark.y_px))
        return metashape_bad(m, "a place in a photograph has no camera_id, x and y", e);
    const struct named *camera = metashape_find(&m->cameras, id);
    if (!camera)
        return err_set(e, ERR_FORMAT, "%s: line %zu: there is no camera of id %lld", m->path,
                       metashape_line(m), id);
    mark.gcp = m->marker->gcp;
    memcpy(mark.image, camera->label, sizeof mark.image);
    return gcp_add_mark(m->l, &mark, e);
}

static enum err_code metashape_open(struct metashape *m, const char *name, const char **att,
                                    struct err *e)
{
    long long id;
    m->chunks += !strcmp(name, "chunk");
    m->frames += !strcmp(name, "frame");
    if (m->chunks > 1)
        return metashape_bad(m, "a second chunk: export the markers of one", e);
    if (metashape_within(m, "frame")) { /* of several, at different times, the first */
        if (m->frames > 1)
            return ERR_OK;
        if (!strcmp(name, "location") && metashape_directly(m, "marker"))
            return metashape_mark(m, att, e);
        if (!strcmp(name, "marker"))
            m->marker =
                metashape_id(att, "marker_id", &id) ? metashape_find(&m->markers, id) : NULL;
        return ERR_OK;
    }
    if (!strcmp(name, "camera") && metashape_within(m, "cameras"))
        return metashape_name(m, att, &m->cameras, GCP_IMAGE_MAX, e);
    if (!strcmp(name, "reference") && metashape_directly(m, "marker"))
        return metashape_place(m, att, e);
    if (strcmp(name, "marker") || !metashape_within(m, "markers"))
        return ERR_OK;
    enum err_code rc = metashape_name(m, att, &m->markers, GCP_NAME_MAX, e);
    m->marker = rc ? NULL : &m->markers.list[m->markers.n - 1];
    return rc;
}

/* ---- what expat calls ---- */

static void metashape_stop(struct metashape *m, enum err_code rc)
{
    m->rc = rc;
    XML_StopParser(m->parser, XML_FALSE);
}

static void XMLCALL metashape_on_open(void *user, const XML_Char *name, const XML_Char **att)
{
    struct metashape *m = user;
    enum err_code rc = metashape_open(m, name, att, m->e);
    if (!rc && m->depth == METASHAPE_DEPTH)
        rc = metashape_bad(m, "elements lie too deep in each other", m->e);
    if (rc)
        metashape_stop(m, rc);
    else
        snprintf(m->in[m->depth++], METASHAPE_NAME, "%s", name);
}

static bool metashape_is_system(const struct metashape *m)
{
    return m->depth > 1 && metashape_directly(m, "reference") &&
           !strcmp(m->in[m->depth - 2], "chunk");
}

static void XMLCALL metashape_on_text(void *user, const XML_Char *text, int n)
{
    struct metashape *m = user;
    if (metashape_is_system(m) && (size_t)n < sizeof m->system - m->n_system) {
        memcpy(m->system + m->n_system, text, (size_t)n);
        m->n_system += (size_t)n;
    }
}

static void XMLCALL metashape_on_close(void *user, const XML_Char *name)
{
    struct metashape *m = user;
    (void)name;
    if (metashape_is_system(m)) {
        int epsg, heights;
        m->system[m->n_system] = '\0';
        const char *text = m->system + strspn(m->system, " \t\r\n");
        m->n_system = 0;
        if (wkt_epsg(text, &epsg, &heights)) {
            m->l->epsg = epsg;
            m->l->heights_epsg = heights;
        }
    }
    m->depth--;
}

/* It could declare entities of any size. */
static void XMLCALL metashape_on_type(void *user, const XML_Char *name, const XML_Char *system,
                                      const XML_Char *id, int internal)
{
    struct metashape *m = user;
    (void)name, (void)system, (void)id, (void)internal;
    metashape_stop(m, metashape_bad(m, "document types are not read", m->e));
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
                 m->path, without, first);
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

static enum err_code metashape_parse(struct metashape *m, const struct buf *b)
{
    m->parser = XML_ParserCreate(NULL);
    if (!m->parser)
        return err_set(m->e, ERR_MEM, "%s: out of memory", m->path);
    XML_SetUserData(m->parser, m);
    XML_SetElementHandler(m->parser, metashape_on_open, metashape_on_close);
    XML_SetCharacterDataHandler(m->parser, metashape_on_text);
    XML_SetStartDoctypeDeclHandler(m->parser, metashape_on_type);
    if (!XML_Parse(m->parser, (const char *)b->data, (int)b->size, XML_TRUE) && !m->rc)
        m->rc = metashape_bad(m, XML_ErrorString(XML_GetErrorCode(m->parser)), m->e);
    XML_ParserFree(m->parser);
    return m->rc;
}

enum err_code gcp_metashape_read(const char *path, struct gcp_list *l, struct err *e)
{
    struct buf b = {0};
    struct metashape m = {.l = l, .path = path, .e = e};
    enum err_code rc = file_read(path, METASHAPE_BYTES_MAX, &b, e);
    if (!rc)
        rc = metashape_parse(&m, &b);
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
