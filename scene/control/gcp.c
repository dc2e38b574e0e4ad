/* Lists of ground control points: see gcp.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "scene/control/gcp.h"

#include <stdio.h>
#include <string.h>

#include "core/base.h"

void gcp_free(struct gcp_list *l)
{
    mem_free(l->gcps);
    mem_free(l->marks);
    mem_free(l->wkt);
    *l = (struct gcp_list){0};
}

enum err_code gcp_find(const char *path, size_t line, struct gcp_list *l, const char *name,
                       const double at[3], size_t *out, struct err *e)
{
    if (strlen(name) >= GCP_NAME_MAX)
        return err_set(e, ERR_FORMAT, "%s: line %zu: '%.40s...': names have at most %d bytes", path,
                       line, name, GCP_NAME_MAX - 1);
    for (size_t i = 0; i < l->n; i++) {
        const struct gcp *g = &l->gcps[i];
        bool there = g->at[0] == at[0] && g->at[1] == at[1] && g->at[2] == at[2];
        if (*name ? strcmp(g->name, name) != 0 : !there)
            continue;
        *out = i;
        if (there)
            return ERR_OK;
        return err_set(
            e, ERR_FORMAT,
            "%s: line %zu: ground control point %s lies at %.10g %.10g %.10g here and at "
            "%.10g %.10g %.10g before: mend the one that is wrong",
            path, line, name, at[0], at[1], at[2], g->at[0], g->at[1], g->at[2]);
    }
    if (l->n == GCP_MAX)
        return err_set(e, ERR_DATA, "more than %d ground control points", GCP_MAX);
    struct gcp *p = mem_room(l->gcps, l->n, &l->cap, 16, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for ground control points");
    l->gcps = p;
    struct gcp *g = &l->gcps[l->n];
    *g = (struct gcp){.at = {at[0], at[1], at[2]}, .file = {at[0], at[1], at[2]}, .line = line};
    if (*name)
        snprintf(g->name, sizeof g->name, "%s", name);
    else
        snprintf(g->name, sizeof g->name, "%zu", l->n + 1);
    *out = l->n++;
    return ERR_OK;
}

enum err_code gcp_add_point(const char *path, struct gcp_list *l, const struct gcp *g,
                            struct err *e)
{
    size_t at = 0;
    enum err_code rc = gcp_find(path, g->line, l, g->name, g->file, &at, e);
    if (!rc)
        l->gcps[at].check |= g->check;
    for (size_t k = 0; !rc && k < 2; k++)
        if (!(l->gcps[at].sigma_m[k] > 0))
            l->gcps[at].sigma_m[k] = g->sigma_m[k];
    return rc;
}

enum err_code gcp_add_mark(struct gcp_list *l, const struct gcp_mark *m, struct err *e)
{
    struct gcp_mark *p = mem_room(l->marks, l->n_marks, &l->cap_marks, 16, sizeof *p);
    if (!p)
        return err_set(e, ERR_MEM, "out of memory for ground control points");
    l->marks = p;
    l->marks[l->n_marks++] = *m;
    return ERR_OK;
}

enum err_code gcp_keep_out(struct gcp_list *l, const char *names, struct err *e)
{
    for (const char *p = names; *p;) {
        size_t n = strcspn(p, ","), found = 0;
        for (size_t i = 0; i < l->n; i++)
            if (strlen(l->gcps[i].name) == n && !strncmp(l->gcps[i].name, p, n)) {
                l->gcps[i].check = true;
                found++;
            }
        if (!found)
            return err_set(e, ERR_ARG,
                           "--check: there is no ground control point '%.*s'; the first is '%s'",
                           (int)(n < 80 ? n : 80), p, l->n ? l->gcps[0].name : "");
        p += n + (p[n] == ',');
    }
    return ERR_OK;
}
