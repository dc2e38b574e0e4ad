/* Nodes of a glTF file: see glb_nodes.h.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "codec/splat/glb_nodes.h"

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <string.h>

#include "core/base.h"

const json_t *glb_array_at(const json_t *root, const char *array, const json_t *index)
{
    if (!json_is_integer(index) || json_integer_value(index) < 0)
        return NULL;
    return json_array_get(json_object_get(root, array), (size_t)json_integer_value(index));
}

enum { GLB_DEPTH = 64, GLB_PLACES = 4096 };

/* Numbers [n] of a node's property; false: it is there, and is something else. */
static bool glb_numbers(const json_t *node, const char *key, size_t n, double *out)
{
    const json_t *list = json_object_get(node, key);
    if (list && json_array_size(list) != n)
        return false;
    for (size_t i = 0; list && i < n; i++) {
        const json_t *v = json_array_get(list, i);
        out[i] = json_number_value(v);
        if (!json_is_number(v) || !isfinite(out[i]))
            return false;
    }
    return true;
}

/* Divides the axes [9] of a matrix of rotation and one scale by it. false: it is no such matrix. */
static bool glb_divide(double axes[9], double *scale)
{
    double det = 0;
    for (size_t k = 0; k < 3; k++)
        det += axes[k] * (axes[3 + (k + 1) % 3] * axes[6 + (k + 2) % 3] -
                          axes[3 + (k + 2) % 3] * axes[6 + (k + 1) % 3]);
    *scale = cbrt(det);
    if (!(*scale > 1e-9 && *scale < 1e9))
        return false;
    for (size_t k = 0; k < 9; k++)
        axes[k] /= *scale;
    for (size_t a = 0; a < 3; a++)
        for (size_t b = a; b < 3; b++) {
            double dot = 0;
            for (size_t k = 0; k < 3; k++)
                dot += axes[3 * a + k] * axes[3 * b + k];
            if (fabs(dot - (a == b)) > 1e-3)
                return false;
        }
    return true;
}

/* A node's own transform: a matrix, or translation, rotation and scale. */
static bool glb_node_place(const json_t *node, struct glb_place *p)
{
    double m[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1}, q[4] = {0, 0, 0, 1},
           size[3] = {1, 1, 1};
    if (!glb_numbers(node, "matrix", 16, m) || !glb_numbers(node, "translation", 3, m + 12) ||
        !glb_numbers(node, "rotation", 4, q) || !glb_numbers(node, "scale", 3, size))
        return false;
    if (!json_object_get(node, "matrix")) { /* by columns */
        const double x = q[0], y = q[1], z = q[2], w = q[3];
        const double turn[9] = {
            1 - 2 * (y * y + z * z), 2 * (x * y + w * z),     2 * (x * z - w * y),
            2 * (x * y - w * z),     1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
            2 * (x * z + w * y),     2 * (y * z - w * x),     1 - 2 * (x * x + y * y)};
        for (size_t k = 0; k < 9; k++)
            m[4 * (k / 3) + k % 3] = turn[k] * size[k / 3];
    }
    for (size_t k = 0; k < 9; k++) /* p->rot is by rows */
        p->rot[k] = m[4 * (k % 3) + k / 3];
    for (size_t k = 0; k < 3; k++)
        p->shift[k] = m[12 + k];
    return glb_divide(p->rot, &p->scale);
}

/* `inner` within `outer`, into inner. */
static void glb_place_in(const struct glb_place *outer, struct glb_place *inner)
{
    const struct glb_place in = *inner;
    for (size_t r = 0; r < 3; r++) {
        inner->shift[r] = outer->shift[r];
        for (size_t k = 0; k < 3; k++) {
            inner->shift[r] += outer->scale * outer->rot[3 * r + k] * in.shift[k];
            inner->rot[3 * r + k] = 0;
            for (size_t c = 0; c < 3; c++)
                inner->rot[3 * r + k] += outer->rot[3 * r + c] * in.rot[3 * c + k];
        }
    }
    inner->scale = outer->scale * in.scale;
}

static enum err_code glb_mesh_walk(const json_t *root, const json_t *node,
                                   const struct glb_place *at, struct glb_places *out,
                                   struct err *e)
{
    const json_t *mesh = glb_array_at(root, "meshes", json_object_get(node, "mesh"));
    size_t k;
    json_t *prim;
    json_array_foreach(json_object_get(mesh, "primitives"), k, prim)
    {
        json_t *splat = json_object_get(json_object_get(prim, "extensions"), GLB_SPLAT);
        if (!splat)
            continue;
        if (out->n == GLB_PLACES)
            return err_set(e, ERR_LIMIT, "glb: more than %d primitives of Gaussians", GLB_PLACES);
        struct glb_place *list = mem_room(out->list, out->n, &out->cap, 8, sizeof *list);
        if (!list)
            return err_set(e, ERR_MEM, "glb: out of memory");
        out->list = list;
        out->list[out->n] = *at;
        out->list[out->n].primitive = prim;
        out->list[out->n++].splat = splat;
    }
    return ERR_OK;
}

/* The node and what is below it. *visits bounds a graph that is no tree. */
static enum err_code glb_node_walk(const json_t *root, const json_t *index,
                                   const struct glb_place *outer, int depth, size_t *visits,
                                   struct glb_places *out, struct err *e)
{
    const json_t *node = glb_array_at(root, "nodes", index);
    const long long number = (long long)json_integer_value(index);
    struct glb_place here = {0};
    size_t i;
    json_t *child;
    if (!node || depth == GLB_DEPTH || ++*visits > GLB_PLACES)
        return err_set(e, ERR_FORMAT, "glb: node %lld: it is not there, or nodes are no tree",
                       number);
    const bool rigid = glb_node_place(node, &here);
    glb_place_in(outer, &here);
    if (!rigid && json_object_get(node, "mesh"))
        return err_set(e, ERR_FORMAT,
                       "glb: node %lld: its transform stretches or mirrors: turns, moves and one "
                       "scale are read; apply it in the program that made the file",
                       number);
    enum err_code rc = glb_mesh_walk(root, node, &here, out, e);
    json_array_foreach(json_object_get(node, "children"), i, child) if (!rc) rc =
        rigid
            ? glb_node_walk(root, child, &here, depth + 1, visits, out, e)
            : err_set(e, ERR_FORMAT, "glb: node %lld: its transform stretches or mirrors", number);
    return rc;
}

enum err_code glb_other_extension(const char *name, struct err *e)
{
    return err_set(
        e, ERR_FORMAT,
        "glb: its Gaussians are in %.80s, which is not read: export the file again with " GLB_SPZ
        ", or as .spz or .ply",
        name);
}

static enum err_code glb_no_places(const json_t *root, struct err *e)
{
    size_t i;
    const json_t *used;
    json_array_foreach(json_object_get(root, "extensionsUsed"), i, used)
    {
        const char *name = json_string_value(used);
        if (name && strcmp(name, GLB_SPLAT) && strcmp(name, GLB_SPZ) &&
            (strstr(name, "splat") || strstr(name, "spz")))
            return glb_other_extension(name, e);
    }
    return err_set(e, ERR_FORMAT, "glb: 0 primitives with " GLB_SPLAT " in its scene");
}

/* All primitives with Gaussians of the scene; of a file without scenes, of all meshes. */
enum err_code glb_places_find(const json_t *root, struct glb_places *out, struct err *e)
{
    static const struct glb_place origin = {.rot = {1, 0, 0, 0, 1, 0, 0, 0, 1}, .scale = 1};
    const json_t *scenes = json_object_get(root, "scenes"),
                 *number = json_object_get(root, "scene");
    const json_t *scene =
        json_array_get(scenes, json_is_integer(number) ? (size_t)json_integer_value(number) : 0);
    size_t i, visits = 0;
    json_t *index;
    enum err_code rc = ERR_OK;
    json_array_foreach(json_object_get(scene, "nodes"), i, index) if (!rc) rc =
        glb_node_walk(root, index, &origin, 0, &visits, out, e);
    for (size_t m = 0; !rc && !scene && m < json_array_size(json_object_get(root, "meshes"));
         m++) { /* a library of meshes */
        json_t *node = json_pack("{s:I}", "mesh", (json_int_t)m);
        rc = node ? glb_mesh_walk(root, node, &origin, out, e)
                  : err_set(e, ERR_MEM, "glb: out of memory");
        json_decref(node);
    }
    return rc || out->n ? rc : glb_no_places(root, e);
}
