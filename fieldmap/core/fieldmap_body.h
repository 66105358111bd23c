/* fieldmap_body.h: a rigid body with magnets in the field of a map, in C99: force and torque on it, and its motion.
 *
 * fieldmap.h has maps, magnetic_body.h the magnets and soft iron, rigid_body.h the motion.
 *
 * BSD-3-Clause, the fieldmap developers.
 */
#ifndef FIELDMAP_BODY_H
#define FIELDMAP_BODY_H

#include "fieldmap.h"
#include "rigid_body.h"

#endif
