/* Steps of Adam that are owed: a step of training touches the groups of Gaussians that its
 * photograph can show, and no others.
 *
 * Adam moves a Gaussian also when its gradient is 0, by what is left of its first moment. A group
 * that was not in the frustum for k steps is owed k such steps. It gets them at once, in closed
 * form, when it comes into view again, and all groups get them in defer_settle. With c = beta1 /
 * sqrt(beta2), last step s, and lr_t divided by both bias corrections of step t:
 *
 *     p -= m1 / (sqrt(m2) + eps) * W_s,   W_s = sum over t of lr_t c^(t - s),   t = s + 1 .. s + k
 *     m1 *= beta1^k,   m2 *= beta2^k
 *
 * W_s depends on s alone, for each learning rate. It does not change once c^(t - s) is nothing to a
 * double. Against k single steps p differs by their roundings, and by eps where sqrt(m2) is not
 * far above it.
 *
 * Which groups a camera may see follows from the bounds of each group: a box around its means, and
 * how far the widest of its Gaussians reaches. Both have room for what momentum can do until the
 * group is in view again. So a frame of the listed groups has the same bits as a frame of all.
 *
 *     settled  uint [groups]: the last step that the group has made
 *     bounds   float [groups / 16][7][16]: centre of the box, relative to the model's origin, its
 *              half-sizes, reach; m
 *
 * Only one thread at a time may use a struct defer.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#ifndef RENDER_DEFER_H
#define RENDER_DEFER_H

#include "render/render.h"

struct defer;
/* Compiles the kernels. r is borrowed. Free *out with defer_close. ERR_DEVICE, ERR_MEM. */
enum err_code defer_open(struct render *r, struct defer **out, struct err *e) ERR_USE;
void defer_close(struct defer **d);

/* Lists in *seen, a copy of *m, the groups that this view may show, and lets them make what steps
 * they are owed. If nothing is known of the groups, all count as settled at adam->step. *seen has
 * d's list: do not free it, and draw it before the next call. Then call render_backward_step with
 * *seen and a step that is one larger, and defer_stepped. ERR_ARG (camera), ERR_MEM, ERR_LIMIT,
 * ERR_DEVICE. */
enum err_code defer_see(struct defer *d, const struct render_model *m,
                        const struct render_adam *adam, const struct camera *cam,
                        const struct render_options *o, struct render_model *seen,
                        struct err *e) ERR_USE;
/* Call it after each step: it notes that step adam->step was made with the learning rates of adam.
 * ERR_MEM. */
enum err_code defer_stepped(struct defer *d, const struct render_adam *adam, struct err *e) ERR_USE;
/* All groups make the steps that they are owed. What is known of them is then forgotten, so that
 * rows may be moved and changed. Does nothing if nothing is known. ERR_MEM, ERR_DEVICE. */
enum err_code defer_settle(struct defer *d, const struct render_model *m,
                           const struct render_adam *adam, struct err *e) ERR_USE;
/* Lists in *seen the groups of a model that is owed nothing, for a frame that is only drawn: then
 * call neither render_backward_step nor defer_stepped. The first such call after steps or
 * defer_moved finds the bounds of all groups. m may have fewer rows than then. Draw *seen before
 * the next call. ERR_ARG (camera), ERR_MEM, ERR_LIMIT, ERR_DEVICE. */
enum err_code defer_look(struct defer *d, const struct render_model *m,
                         const struct render_adam *adam, const struct camera *cam,
                         const struct render_options *o, struct render_model *seen,
                         struct err *e) ERR_USE;
/* Rows have changed or moved: bounds that were found for defer_look no longer hold. */
void defer_moved(struct defer *d);
/* Whether groups may be owed steps. NULL is accepted. */
bool defer_owes(const struct defer *d);

/* A state that is saved as it is goes on as if it had not been saved; defer_settle in between would
 * round differently. defer_save gives the buffer `settled` for [m->groups]. defer_restore takes its
 * content back; defer_stepped then has to follow for every step from the returned one, the least of
 * them, up to now. ERR_MEM, ERR_DEVICE. */
enum err_code defer_save(struct defer *d, const struct render_model *m,
                         const struct render_adam *adam, cl_mem *out, struct err *e) ERR_USE;
enum err_code defer_restore(struct defer *d, const struct render_model *m, const uint32_t *settled,
                            uint32_t *first, struct err *e) ERR_USE;

#endif
